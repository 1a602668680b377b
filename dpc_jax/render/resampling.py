"""Trilinear samples of a volume at any place, with gradients to volume and places."""

import functools

import jax
import jax.numpy as jnp

_IN_BOUNDS = "promise_in_bounds"


def sample_volume(
    volume: jax.Array, coordinates: tuple[jax.Array, jax.Array, jax.Array]
) -> jax.Array:
    """Values between the cells of a volume, zero beyond its rim.

    A cell is a tent: full at its centre, fading to zero at the centres of its
    neighbours, or at the same distance beyond the rim. The backward pass takes the
    samples again and keeps no corner.

    Args:
      volume: [X, Y, Z].
      coordinates: [...] continuous index along each axis; cell i has its centre at i.
        Those that are not finite count as beyond the rim.

    Returns:
      [...]. The gradient with respect to the coordinates is that of the tents; on a
      cell's centre it is that towards the higher index.
    """
    flat = tuple(along.ravel() for along in coordinates)
    return _sample(volume, flat).reshape(coordinates[0].shape)


@jax.custom_vjp
def _sample(volume, coordinates):
    """Samples [N] at three [N]."""
    first, shares, is_near = _find_corners(coordinates, volume.shape)
    planes, _ = _blend(_read_corners(volume, first), shares)
    return jnp.where(is_near, _mix(planes, shares[0]), 0)


def _find_corners(coordinates, shape):
    """Lower corners in the padded volume, shares of the upper, who has any; by axis."""
    pairs = zip(coordinates, shape, strict=True)
    near = [(along > -1) & (along < size) for along, size in pairs]
    is_near = functools.reduce(jnp.logical_and, near)
    # Beyond the rim every sample reads padding, and has no gradient.
    safe = [jnp.where(is_near, along, 0) for along in coordinates]
    lower = [jnp.floor(along) for along in safe]
    first = [along.astype(jnp.int32) + 1 for along in lower]
    shares = [along - below for along, below in zip(safe, lower, strict=True)]
    return first, shares, is_near


def _read_corners(volume, first):
    """The cells about each sample, [N, 2, 2, 2], as one window.

    XLA on a CPU repeats eight single reads for each result of the backward pass, which
    then takes three times as long.
    """
    return jax.lax.gather(
        jnp.pad(volume, 1),
        jnp.stack(first, axis=-1),
        jax.lax.GatherDimensionNumbers(
            offset_dims=(1, 2, 3), collapsed_slice_dims=(), start_index_map=(0, 1, 2)
        ),
        slice_sizes=(2, 2, 2),
        mode=_IN_BOUNDS,
    )


def _mix(pair, share):
    return pair[0] * (1 - share) + pair[1] * share


def _blend(corners, shares):
    """Values on the two planes of the first axis, and their slopes along the others."""
    _, along_y, along_z = shares
    planes, slopes = [], []
    for plane in (corners[:, 0], corners[:, 1]):
        lines = [_mix((plane[:, i, 0], plane[:, i, 1]), along_z) for i in (0, 1)]
        steps = [plane[:, i, 1] - plane[:, i, 0] for i in (0, 1)]
        planes.append(_mix(lines, along_y))
        slopes.append((lines[1] - lines[0], _mix(steps, along_y)))
    return planes, slopes


def _sample_forward(volume, coordinates):
    return _sample(volume, coordinates), (volume, coordinates)


def _sample_backward(residuals, cotangent):
    volume, coordinates = residuals
    first, shares, is_near = _find_corners(coordinates, volume.shape)
    cotangent = jnp.where(is_near, cotangent, 0)
    planes, slopes = _blend(_read_corners(volume, first), shares)
    slope = [planes[1] - planes[0]]
    slope += [_mix(pair, shares[0]) for pair in zip(*slopes, strict=True)]
    # The condition makes the sum a computation of its own. Without it XLA on a CPU
    # computes the cotangents again for each of the eight cells that they go to, and a
    # silhouette's gradient takes three times as long.
    volume_grad = jax.lax.cond(
        jnp.any(is_near),
        lambda: _add_corners(cotangent, first, shares, volume.shape),
        lambda: jnp.zeros_like(volume),
    )
    return volume_grad, tuple(along * cotangent for along in slope)


def _add_corners(values, first, shares, shape):
    """Each value's shares in the cells about it, summed: the transpose of reading.

    Four times one pair of cells along z. Eight single cells and one window of 2×2×2
    take one and a half times, and three times, as long (a CPU).
    """
    rows, cols, depth = (side + 2 for side in shape)
    start = (first[0] * cols + first[1]) * depth + first[2]
    row, col, pair = (jnp.stack([1 - share, share], axis=-1) for share in shares)
    cells = jnp.zeros(rows * cols * depth, values.dtype)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cells = jax.lax.scatter_add(
            cells,
            (start + (i * cols + j) * depth)[:, None],
            (values * row[:, i] * col[:, j])[:, None] * pair,
            jax.lax.ScatterDimensionNumbers(
                update_window_dims=(1,),
                inserted_window_dims=(),
                scatter_dims_to_operand_dims=(0,),
            ),
            mode=_IN_BOUNDS,
        )
    return cells.reshape(rows, cols, depth)[1:-1, 1:-1, 1:-1]


_sample.defvjp(_sample_forward, _sample_backward)
