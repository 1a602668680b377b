"""From points to the volume that rays go through: the transform T_c and Eq. 3."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from dpc_jax.render import arguments, checks, quaternion
from dpc_jax.render.camera import Camera, VoxelGrid, to_camera_frame, to_grid
from dpc_jax.render.exact import covariances, gaussians
from dpc_jax.render.fast import smoothing, splatting

# Up to so many channels of colour, volumes are kept for the backward pass. Filling them
# again took as long as all the rest: 34 ms for a render with its gradient where keeping
# them takes 17 (64 voxels, 8000 points, three channels, a CPU).
_KEPT_CHANNELS = 4


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene:
    """Points in the grid, with all parameters of their densities."""

    coordinates: jax.Array  # [N, 3] continuous (row, col, depth) index
    mass: jax.Array  # [N] in voxels, zero for a point outside
    is_inside: jax.Array  # [N] bool, in the volume and in front of the camera
    sigma: jax.Array | None  # () or [N] in voxels
    covariance: jax.Array | None  # [N, 3, 3] in the grid's axes, voxels²
    # "gaussian", or one of `splatting.ORDERS`
    method: str = dataclasses.field(metadata={"static": True})


def place_points(
    points: ArrayLike,
    rotation: ArrayLike,
    sigma: ArrayLike | None,
    scale: ArrayLike,
    covariance: ArrayLike | None,
    translation: ArrayLike | None,
    camera: Camera,
    grid: VoxelGrid,
    method: str,
) -> Scene:
    """Apply the paper's transform T_c to points and to their covariances.

    Arguments and errors as of `project`. The result has the dtype of the points.
    """
    hint = "use jax.vmap or jax.lax.map over a batch of clouds"
    points = checks.check_array("points", points, ("N", 3), hint=hint)
    arguments.check_view(camera, grid)
    rotation, sigma, scale, covariance, translation = arguments.convert_scene(
        points, rotation, sigma, scale, covariance, translation
    )
    method = arguments.choose_method(method, sigma)
    moved = to_camera_frame(points, rotation, translation)
    coordinates, is_inside = to_grid(moved, camera=camera, grid=grid)
    if covariance is not None:
        matrix = quaternion.to_matrix(rotation) if rotation.shape == (4,) else rotation
        # A point outside may lie in the camera plane: perspective has no derivative.
        x, y, _ = jnp.where(is_inside[:, None], moved, 0).T
        ahead = jnp.where(is_inside, camera.find_depths(moved), 1)
        safe = jnp.stack([x, y, ahead], axis=-1)
        covariance = covariances.move_covariance(
            covariance, safe, matrix, camera=camera, grid=grid
        )
    mass = jnp.where(is_inside, scale, 0)
    return Scene(coordinates, mass, is_inside, sigma, covariance, method)


def fill_volume(
    scene: Scene, colors: jax.Array | None, shape: tuple[int, int, int]
) -> tuple[jax.Array, Callable | None]:
    """Eq. 3 of the paper: Σ_i f_i(x) on the grid, whose clip is the occupancy o(x).

    With colours, also what the paper gives after Eq. 5 as the signal
    y(x) = Σ_i y_i·f_i(x) / Σ_i f_i(x). Colours are [N, C]; the shape is (rows, cols,
    depth).

    Returns:
      ([rows, cols, depth] densities, nearest first; map_colors(function), which gives
      function(Σ y_i·f_i) of each channel, [C, ...], or None without colours). A
      function, so that there may be one channel's volume at a time.

    Raises:
      ValueError: for a volume that does not fit into memory.
    """
    checks.check_room("grid", shape, scene.coordinates.dtype)
    colors = None if colors is None else colors.astype(scene.coordinates.dtype)
    sum_densities = _sum_exact if scene.method == "gaussian" else _sum_smoothed
    density, map_colors = sum_densities(scene, colors, shape)
    return density, None if colors is None else map_colors


@jax.custom_jvp
def clip_unit(density: jax.Array) -> jax.Array:
    """Clip the summed densities to [0, 1] (part of Eq. 3).

    The derivative at both kinks is one, the one-sided derivative from inside: most
    cells are exactly 0 and have to receive a gradient.
    """
    return jnp.clip(density, 0, 1)


@clip_unit.defjvp
def _clip_unit_jvp(primals, tangents):
    (density,), (tangent,) = primals, tangents
    passes = (density >= 0) & (density <= 1)
    return clip_unit(density), jnp.where(passes, tangent, 0)


def _sum_smoothed(scene, colors, shape):
    """`fill_volume` by the fast methods.

    The backward pass keeps the volumes of few channels, and fills those of many again.
    """
    order = splatting.ORDERS[scene.method]
    sigma = splatting.narrow(scene.sigma, order)

    def fill(mass):
        mass = jnp.where(scene.is_inside, mass, 0)
        volume = splatting.splat_inside(scene.coordinates, mass, shape, order)
        return smoothing.smooth(volume, sigma)

    def map_colors(function):
        return map_channels(lambda c: function(fill(scene.mass * c)), colors)

    return fill(scene.mass), map_colors


def map_channels(function: Callable, colors: jax.Array) -> jax.Array:
    """function(channel [N]) of each channel of colours [N, C], one after the other."""
    is_many = colors.shape[1] > _KEPT_CHANNELS
    return jax.lax.map(jax.checkpoint(function) if is_many else function, colors.T)


def _sum_exact(scene, colors, shape):
    """`fill_volume` by the basic method; exact, slower than `_sum_smoothed`."""
    values = scene.mass[:, None]
    if colors is not None:
        values = jnp.concatenate([values, values * colors], axis=1)
    is_full = scene.covariance is not None
    sum_points = covariances.sum_covariances if is_full else gaussians.sum_gaussians
    size = scene.covariance if is_full else scene.sigma
    volumes = sum_points(
        scene.coordinates, values, size, shape=shape, is_inside=scene.is_inside
    )
    return volumes[0], lambda function: jax.vmap(function)(volumes[1:])
