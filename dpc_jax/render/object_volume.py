"""Projection of a volume: occupancies of the object frame, seen from a camera.

Voxel models (PTN, DRC, MVC, the paper's Ours-V) predict cells that do not move with the
camera. They are resampled along its rays, and what follows is the projection of point
clouds: clip, ray termination, silhouette, depth, colour.
"""

import chex
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from dpc_jax.render import arguments, checks, quaternion
from dpc_jax.render.camera import Camera, VoxelGrid, place_cells
from dpc_jax.render.fast import splatting
from dpc_jax.render.projection import Projection, project_signals
from dpc_jax.render.volume import Volume, clip_unit

_HINT = "use jax.vmap or jax.lax.map over a batch of volumes"


@checks.refusing_forward_mode
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
    volume = checks.check_array("volume", volume, ("X", "Y", "Z"), hint=_HINT)
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
    places = _place_samples(
        volume.shape, rotation, translation, camera, grid, volume.dtype
    )
    rays = _fill_rays(volume, colors, *places, signals)
    return project_signals(rays, camera, grid, signals, ray_rule, background)


def _place_samples(shape, rotation, translation, camera, grid, dtype):
    """Where the grid's cells lie in the volume: the inverse of T_c.

    Offset and lower corner [rows·cols·depth, 3], in the volume with a rim of empty
    cells, and [rows, cols, depth] bool, which cells of the grid see the volume.
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
    index = jnp.stack([jnp.where(is_seen, x, 0).ravel() for x in found], axis=-1)
    lower = jnp.floor(jax.lax.stop_gradient(index))
    # The two passes may round apart.
    lower = jnp.clip(lower, -1, jnp.array([shape]) - 1).astype(jnp.int32)
    return index - lower, lower + 1, is_seen


def _find_indices(places, matrix, shape):
    # Rᵀ·x as sums: a matrix product [cells, 3]·[3, 3] takes twenty times as long on a
    # CPU, and a GPU would round it to TF32.
    turned = [
        sum(x * along for x, along in zip(places, column, strict=True))
        for column in matrix.T
    ]
    return [(x + 0.5) * side - 0.5 for x, side in zip(turned, shape, strict=True)]


def _fill_rays(volume, colors, offset, corner, is_seen, signals) -> Volume:
    """What the rays go through; cells behind the camera are empty.

    A cell of the volume is a tent: full at its centre, fading to zero at the centres of
    its neighbours, or at the same distance beyond the rim.
    """

    def sample(cells: jax.Array) -> jax.Array:
        values = splatting.sample(jnp.pad(cells, 1), offset, corner)
        return jnp.where(is_seen, values.reshape(is_seen.shape), 0)

    density = sample(volume)
    occupancy = clip_unit(density)
    if "color" not in signals:
        return Volume(occupancy)

    def sum_colors(reached: ArrayLike) -> jax.Array:
        # One channel's samples at a time, as in `fill_volume`.
        safe = jnp.where(density > 1, density, 1)

        @jax.checkpoint
        def call(channel):
            return jnp.sum(reached * _divide(sample(volume * channel), safe), axis=-1)

        channels = jax.lax.map(call, jnp.moveaxis(colors, -1, 0))
        return jnp.moveaxis(channels, 0, -1)

    return Volume(occupancy, sum_colors)


@jax.custom_jvp
def _divide(total, density):
    """A quotient whose derivative squares no density: 1e30 has no square in float32."""
    return total / density


@_divide.defjvp
def _divide_jvp(primals, tangents):
    total, density = primals
    quotient = total / density
    return quotient, (tangents[0] - quotient * tangents[1]) / density
