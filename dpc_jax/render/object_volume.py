"""Projection of a volume: occupancies of the object frame, seen from a camera.

Voxel models (PTN, DRC, MVC, the paper's Ours-V) predict cells that do not move with the
camera. They are resampled along its rays, and what follows is the projection of point
clouds: clip, ray termination, silhouette, depth, colour.
"""

from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import arguments, checks, quaternion
from dpc_jax.render.camera import Camera, VoxelGrid, place_cells
from dpc_jax.render.projection import Projection, project_signals

_IN_BOUNDS = "promise_in_bounds"


def project_volume(
    volume: jax.Array,
    rotation: jax.Array,
    *,
    colors: jax.Array | None = None,
    translation: jax.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    signals: tuple[str, ...] = ("silhouette",),
    ray_rule: str = "termination",
    background_depth: chex.Numeric = 10.0,
    background_color: chex.Numeric = 1.0,
) -> Projection:
    """Render one volume of occupancies from one camera pose.

    The volume is the object frame's unit cube; cell i of X has its centre at
    (i + 1/2)/X - 1/2. Between centres it is interpolated, and beyond the outermost it
    fades to zero within a cell. Each ray takes a sample per cell of the grid: a grid
    coarser than the volume may miss thin parts.

    Differentiable (in reverse mode) with respect to every array: volume, rotation,
    colors, translation, focal length, distance, background values.

    Args:
      volume: [X, Y, Z] occupancies in [0, 1], object frame; float. What is outside is
        clipped after the interpolation; a cell that is not finite makes the rays that
        read it NaN, and no others. Their dtype decides that of the result.
      rotation: [4] quaternion wxyz or [3, 3] matrix, object to camera.
      colors: [X, Y, Z, C] of the cells, needed for the signal "color". Between cells
        they are mixed by occupancy.
      translation: [3], object to camera, after the rotation.
      camera, grid, signals, ray_rule, background_depth, background_color: as in
        `project`. Voxel models in the literature have "maximum" (PTN) or "termination"
        (DRC, MVC, Ours-V) rays.

    Returns:
      `Projection`, as of `project`.

    Raises:
      ValueError: for a wrong shape or dtype, 2³¹ cells, an unknown signal or rule, and
        colour asked without colours.

    Example:
      >>> dpc_jax.project_volume(jnp.ones((8, 8, 8)), jnp.eye(3)).silhouette.shape
      (64, 64)
    """
    hint = "use jax.vmap or jax.lax.map over a batch of volumes"
    volume = checks.check_array("volume", volume, ("X", "Y", "Z"), hint=hint)
    if 0 in volume.shape:
        raise ValueError(
            "volume must have at least one cell along each axis, but its shape is "
            f"{list(volume.shape)}; give occupancies [X, Y, Z]."
        )
    checks.check_room("volume", volume.shape, volume.dtype)
    arguments.check_view(camera, grid)
    checks.check_room("grid", grid.shape, volume.dtype)
    arguments.check_signals(signals, ray_rule, has_colors=colors is not None)
    background = background_depth, background_color
    colors = arguments.convert_colors(colors, volume.shape, background)
    colors = None if colors is None else colors.astype(volume.dtype)
    rotation, translation = arguments.convert_pose(rotation, translation, volume.dtype)
    coordinates, is_seen = _place_samples(
        volume.shape, rotation, translation, camera, grid, volume.dtype
    )
    filled = _fill_rays(volume, colors, coordinates, is_seen, signals)
    return project_signals(*filled, camera, grid, signals, ray_rule, background)


def _place_samples(shape, rotation, translation, camera, grid, dtype):
    """Where the grid's cells lie in the volume, and which of them see it.

    The inverse of T_c: an index per axis, 0 where none is seen, and a bool, each
    [rows, cols, depth].
    """
    places, is_ahead = place_cells(camera, grid, dtype)
    if translation is not None:
        places = [x - moved for x, moved in zip(places, translation, strict=True)]
    matrix = quaternion.to_matrix(rotation) if rotation.shape == (4,) else rotation
    # In two passes, as in `to_grid`: the first, without gradient, finds the cells that
    # see the volume; the second differentiates those alone. The index of a cell far
    # away may overflow, and infinity times zero would turn all gradients to NaN.
    is_seen = is_ahead[None, None]
    found = _find_indices(*jax.lax.stop_gradient((places, matrix)), shape)
    for index, side in zip(found, shape, strict=True):
        is_seen &= (index > -1) & (index < side)
    places = [jnp.where(is_seen, x, 0) for x in places]
    found = _find_indices(places, matrix, shape)
    return tuple(jnp.where(is_seen, index, 0) for index in found), is_seen


def _find_indices(places, matrix, shape):
    # Rᵀ·x as sums: a matrix product [cells, 3]·[3, 3] takes twenty times as long on a
    # CPU, and a GPU would round it to TF32.
    turned = [
        sum(x * along for x, along in zip(places, column, strict=True))
        for column in matrix.T
    ]
    return [(x + 0.5) * side - 0.5 for x, side in zip(turned, shape, strict=True)]


def _fill_rays(volume, colors, coordinates, is_seen, signals):
    """What `fill_volume` gives for points; cells behind the camera are empty."""
    places = tuple(index.ravel() for index in coordinates)

    def sample(cells: jax.Array) -> jax.Array:
        return jnp.where(is_seen, _sample(cells, places).reshape(is_seen.shape), 0)

    def map_colors(function: Callable) -> jax.Array:
        call = jax.checkpoint(lambda channel: function(sample(volume * channel)))
        return jax.lax.map(call, jnp.moveaxis(colors, -1, 0))

    return sample(volume), map_colors if "color" in signals else None


@jax.custom_vjp
def _sample(volume, coordinates):
    """Values [N] of a volume [X, Y, Z] at continuous indices, [N] along each axis.

    A cell is a tent: full at its centre, fading to zero at the centres of its
    neighbours, or at the same distance beyond the rim. On a centre the slope is that
    towards the higher index. The backward pass takes the samples again and keeps no
    corner.
    """
    first, shares = _find_corners(coordinates, volume.shape)
    planes, _ = _blend(_read_corners(volume, first), shares)
    return _mix(planes, shares[0])


def _find_corners(coordinates, shape):
    """Lower corners in the padded volume, and the shares of the upper ones; by axis."""
    pairs = list(zip(coordinates, shape, strict=True))
    # Clipped, because rounding may move a sample at the rim beyond it.
    lower = [jnp.clip(jnp.floor(along), -1, size - 1) for along, size in pairs]
    first = [along.astype(jnp.int32) + 1 for along in lower]
    shares = [along - below for along, below in zip(coordinates, lower, strict=True)]
    return first, shares


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
    first, shares = _find_corners(coordinates, volume.shape)
    planes, slopes = _blend(_read_corners(volume, first), shares)
    slope = [planes[1] - planes[0]]
    slope += [_mix(pair, shares[0]) for pair in zip(*slopes, strict=True)]
    # The condition makes the sum a computation of its own. Without it XLA on a CPU
    # computes the cotangents again for each of the eight cells that they go to, and a
    # silhouette's gradient takes three times as long.
    volume_grad = jax.lax.cond(
        jnp.any(cotangent != 0),
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
