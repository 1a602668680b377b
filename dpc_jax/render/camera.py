"""The camera and the voxel grid: from the object frame to grid indices.

Camera frame: x right, y down, z forward. A point goes there by rotation, then
translation, then `distance` along z. The image spans [-extent/2, extent/2] in u and v;
the volume spans [distance - extent/2, distance + extent/2] along z. Samples sit at cell
centres: cell i of D has coordinate ((i + 1/2)/D - 1/2)·extent.
"""

import dataclasses
import numbers

import chex
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike, DTypeLike

from dpc_jax.render import checks, quaternion

_PROJECTIONS = ("perspective", "orthographic")
# Smallest depth that has an image, in extents (heuristic). Of a nearer point 1/z² may
# overflow, which would make the gradient of every other input NaN.
_NEAR = 1e-6
_STATIC = {"static": True}  # known to `register_dataclass`


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera that looks along z; `from_opencv` makes one from a matrix K in pixels.

    All numbers may be traced.

    Attributes:
      focal_length: () in units of the image plane where the paper's image is 1 wide.
        The paper's camera has 1.875.
      distance: () from the camera to the object's origin along z.
      projection: "perspective" or "orthographic" (no division by z); static.
      principal_point: [2], the place (u, v) in the image plane that the optical axis
        meets; None for its middle, (0, 0).
      aspect: () vertical focal length in units of the horizontal one; None for 1.

    Raises:
      ValueError: for another projection.

    Example:
      >>> dpc_jax.Camera(focal_length=1.5).distance
      2.0
    """

    focal_length: chex.Numeric = 1.875
    distance: chex.Numeric = 2.0
    projection: str = dataclasses.field(default="perspective", metadata=_STATIC)
    principal_point: ArrayLike | None = None
    aspect: chex.Numeric | None = None

    def __post_init__(self):
        name, hint = "Camera projection", "choose one of these"
        checks.check_choice(name, self.projection, _PROJECTIONS, hint)

    def list_numbers(self) -> dict[str, ArrayLike]:
        """Its numbers by name, "camera.distance" for instance; without None."""
        names = ("focal_length", "distance", "principal_point", "aspect")
        found = {f"camera.{name}": getattr(self, name) for name in names}
        return {name: value for name, value in found.items() if value is not None}

    def find_depths(self, points: jax.Array) -> jax.Array:
        """Depths z [N] before the eye of points [N, 3] of `to_camera_frame`."""
        return points[:, 2] + jnp.asarray(self.distance, points.dtype)


@dataclasses.dataclass(frozen=True, init=False)
class VoxelGrid:
    """The volume through which points are rendered; static.

    Attributes:
      shape: (rows, cols, depth); the constructor also takes one int for a cube.
      extent: width of the image plane and depth of the volume that the grid covers.

    Raises:
      ValueError: if a side is not a positive integer or the extent is not positive.

    Example:
      >>> dpc_jax.VoxelGrid(32).shape
      (32, 32, 32)
    """

    shape: tuple[int, int, int]
    extent: float

    def __init__(self, shape: tuple[int, int, int] | int = 64, extent: float = 1.0):
        is_cube = isinstance(shape, numbers.Integral)
        sides = checks.check_sides("grid", (shape,) * 3 if is_cube else shape)
        is_number = isinstance(extent, numbers.Real) and extent is not True
        if not (is_number and 0 < extent < float("inf")):
            raise ValueError(
                "VoxelGrid extent must be a positive finite number, but it is "
                f"{extent!r}; the unit cube has extent 1.0."
            )
        object.__setattr__(self, "shape", sides)
        object.__setattr__(self, "extent", extent)

    def depths(self, camera: Camera, dtype: DTypeLike = jnp.float32) -> jax.Array:
        """Metric depth z_k of each cell along a ray, [depth], nearest first."""
        return self.centers(2, dtype) + jnp.asarray(camera.distance, dtype)

    def centers(self, axis: int, dtype: DTypeLike = jnp.float32) -> jax.Array:
        """Centres of the cells along an axis, relative to the middle of the volume."""
        size = self.shape[axis]
        return ((jnp.arange(size, dtype=dtype) + 0.5) / size - 0.5) * self.extent


jax.tree_util.register_static(VoxelGrid)


def to_camera_frame(
    points: jax.Array, rotation: jax.Array, translation: jax.Array | None
) -> jax.Array:
    """Move points [N, 3] to the camera's axes: T_c before the perspective division.

    Relative to the middle of the volume, in depth too: relative to a distant eye, depth
    would lose the digits that place a point in the volume.
    """
    moved = quaternion.rotate(points, rotation)
    if translation is not None:
        moved = moved + jnp.asarray(translation, points.dtype)[None]
    return moved


def to_grid(
    points: jax.Array, *, camera: Camera, grid: VoxelGrid
) -> tuple[jax.Array, jax.Array]:
    """Project points of `to_camera_frame`, the rest of T_c; depth stays metric.

    Points behind the camera plane, or less than a millionth of the extent in front of
    it, have no perspective image: they are marked as outside. A point outside has zero
    gradient.

    Returns:
      ([N, 3] continuous (row, col, depth) index, [N] bool, whether a point is in the
      volume and in front of the camera).
    """
    x, y, z = points.T
    ahead = camera.find_depths(points)
    is_inside = jnp.ones_like(z, bool)
    if camera.projection == "perspective":
        is_inside = ahead > _NEAR * grid.extent
    # In two passes. The first, without gradient, finds the points inside; the second
    # differentiates those alone. The coordinates of a point far outside may overflow,
    # and in the derivative infinity times zero would turn all gradients to NaN.
    for fraction in _find_fractions(
        *jax.lax.stop_gradient((x, y, z, jnp.where(is_inside, ahead, 1))), camera, grid
    ):
        is_inside &= (fraction >= 0) & (fraction <= 1)
    x, y, z = (jnp.where(is_inside, value, 0) for value in (x, y, z))
    fractions = _find_fractions(x, y, z, jnp.where(is_inside, ahead, 1), camera, grid)
    coordinates = [
        jnp.where(is_inside, fraction * size - 0.5, 0)
        for fraction, size in zip(fractions, grid.shape, strict=True)
    ]
    return jnp.stack(coordinates, axis=-1), is_inside


def _find_fractions(x, y, z, ahead, camera, grid):
    """Place in the volume along (row, col, depth), [0, 1] inside."""
    if camera.projection == "perspective":
        inverse = jnp.asarray(camera.focal_length, z.dtype) / ahead
        x, y = x * inverse, y * inverse
    if camera.aspect is not None:
        y = y * jnp.asarray(camera.aspect, y.dtype)
    if camera.principal_point is not None:
        u, v = jnp.asarray(camera.principal_point, z.dtype)
        x, y = x + u, y + v
    return [value / grid.extent + 0.5 for value in (y, x, z)]


def place_cells(
    camera: Camera, grid: VoxelGrid, dtype: DTypeLike = jnp.float32
) -> tuple[tuple[jax.Array, jax.Array, jax.Array], jax.Array]:
    """Where the cells of a grid are: T_c's perspective, the other way round.

    Returns:
      (x, y, z [rows, cols, depth] in the camera's axes, from the middle of the volume;
      [depth] bool, whether a cell is in front of the camera).
    """
    v, u, z = (grid.centers(axis, dtype) for axis in range(3))
    if camera.principal_point is not None:
        middle = jnp.asarray(camera.principal_point, dtype)
        u, v = u - middle[0], v - middle[1]
    if camera.aspect is not None:
        v = v / jnp.asarray(camera.aspect, dtype)
    v, u, z = jnp.meshgrid(v, u, z, indexing="ij")
    ahead = z[0, 0] + jnp.asarray(camera.distance, dtype)
    if camera.projection == "orthographic":
        return (u, v, z), jnp.ones_like(ahead, bool)
    is_ahead = ahead > _NEAR * grid.extent
    widening = jnp.where(is_ahead, ahead, 1) / jnp.asarray(camera.focal_length, dtype)
    widening = widening[None, None]
    return (u * widening, v * widening, z), is_ahead
