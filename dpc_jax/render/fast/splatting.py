"""Trilinear splatting, the first step of the fast method."""

import functools

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import checks


def splat(
    coordinates: jax.Array,
    values: jax.Array,
    shape: tuple[int, int, int],
) -> jax.Array:
    """Spread each point's value over its eight neighbouring cells.

    Part of Eq. 3 by the fast method (appendix "Differentiable point cloud projection").

    Args:
      coordinates: [N, 3] continuous (row, col, depth) index, cell centres at integers.
        A point outside the volume, beyond [-1/2, D - 1/2] along an axis, contributes
        nothing; a point inside loses the share that falls on cells outside.
      values: [N], what each point adds in total.
      shape: (rows, cols, depth), static.

    Returns:
      [rows, cols, depth]. The weights are linear between cell centres, so their
      derivative jumps there; on a cell centre it is that towards the higher index.

    Raises:
      ValueError: for another shape or dtype.

    Example:
      >>> volume = dpc_jax.splat(jnp.array([[1.5, 2, 2]]), jnp.ones(1), (4, 4, 4))
      >>> float(volume[1, 2, 2])
      0.5
    """
    checks.check_sides("shape", shape)
    coordinates = checks.check_array("coordinates", coordinates, (None, 3))
    values = checks.check_array("values", values, coordinates.shape[:1])
    return _splat(coordinates, values.astype(coordinates.dtype), tuple(shape))


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def _splat(coordinates, values, shape):
    base, weights, is_inside = _find_neighbours(coordinates, shape)
    row, col, depth = weights
    block = row[:, :, None, None] * col[:, None, :, None] * depth[:, None, None, :]
    updates = jnp.where(is_inside, values, 0)[:, None, None, None] * block
    # A margin of one cell takes what falls outside. So no index is negative, which
    # would wrap to the far side, and each point is one window of 2×2×2 cells.
    padded = jax.lax.scatter_add(
        jnp.zeros([s + 2 for s in shape], values.dtype),
        base + 1,
        updates,
        jax.lax.ScatterDimensionNumbers(
            update_window_dims=(1, 2, 3),
            inserted_window_dims=(),
            scatter_dims_to_operand_dims=(0, 1, 2),
        ),
        mode="promise_in_bounds",
    )
    return padded[1:-1, 1:-1, 1:-1]


def _find_neighbours(coordinates, shape):
    """Lower corner [N, 3] of each point's cell, its two weights along each axis."""
    sizes = jnp.array(shape, coordinates.dtype)[None]
    is_inside = jnp.all((coordinates >= -0.5) & (coordinates <= sizes - 0.5), axis=-1)
    safe = jnp.where(is_inside[:, None], coordinates, 0)
    base = jnp.floor(safe)
    fraction = safe - base
    weights = [jnp.stack([1 - f, f], axis=-1) for f in fraction.T]
    return base.astype(jnp.int32), weights, is_inside


def _splat_forward(coordinates, values, shape):
    return _splat(coordinates, values, shape), (coordinates, values)


def _splat_backward(shape, residuals, cotangent):
    """Read the cotangent at the eight corners, as four pairs along the rays.

    On a CPU the plain transpose, a gather of 2×2×2 windows, is several times slower,
    and eight single reads take half as long again as four pairs.
    """
    coordinates, values = residuals
    base, weights, is_inside = _find_neighbours(coordinates, shape)
    padded = jnp.pad(cotangent, 1)
    rows, cols, depth = padded.shape
    first = ((base[:, 0] + 1) * cols + base[:, 1] + 1) * depth + base[:, 2] + 1

    def read(row, col):
        return jax.lax.gather(
            padded.reshape(-1),
            (first + (row * cols + col) * depth)[:, None],
            jax.lax.GatherDimensionNumbers(
                offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,)
            ),
            slice_sizes=(2,),
            mode="promise_in_bounds",
        )

    # pairs[row][col]; the weights (1 - f, f) have the derivatives (-1, 1).
    pairs = [[read(row, col) for col in (0, 1)] for row in (0, 1)]
    row, col, depth = weights
    along = [[jnp.sum(pair * depth, axis=-1) for pair in line] for line in pairs]
    slope = [[pair[:, 1] - pair[:, 0] for pair in line] for line in pairs]

    def blend(corners, row, col):
        return sum(
            row[:, i] * (corners[i][0] * col[:, 0] + corners[i][1] * col[:, 1])
            for i in (0, 1)
        )

    step = jnp.array([[-1, 1]], values.dtype)
    grads = jnp.stack(
        [blend(along, step, col), blend(along, row, step), blend(slope, row, col)],
        axis=-1,
    )
    mask = jnp.where(is_inside, values, 0)
    value_grad = jnp.where(is_inside, blend(along, row, col), 0)
    return grads * mask[:, None], value_grad


_splat.defvjp(_splat_forward, _splat_backward)


def compensate_widening(sigma: chex.Numeric) -> jax.Array:
    """The sigma with which the fast method draws points as wide as the basic one.

    Trilinear weights have a width of their own: along an axis, with the fractional
    offset r, their variance is r(1 - r), on average 1/6 voxel². Smoothing adds σ². So
    √(σ² - 1/6) draws what the basic method draws with σ: at two voxels the difference
    between the images is 16 times smaller, that between the gradients as before
    (docs/projection.md). Below one voxel a point is not smooth on the grid, and less is
    subtracted (a heuristic), down to nothing at half a voxel. Sigma may have any shape,
    in voxels, >= 0; the result is continuous and increasing.

    Returns:
      The sigma to render with, of the same shape.

    Example:
      >>> round(float(dpc_jax.compensate_widening(2.0)), 3)
      1.958
    """
    sigma = jnp.asarray(sigma)
    share = jnp.clip(2 * sigma - 1, 0, 1)
    # From half a voxel on the root is taken of at least 1/4: no slope is infinite.
    is_wide = sigma > 0.5
    safe = jnp.where(is_wide, sigma, 1)
    return jnp.where(is_wide, safe * jnp.sqrt(1 - share / 6 / safe / safe), sigma)
