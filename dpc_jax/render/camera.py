"""The camera and the voxel grid: from the object frame to grid indices.

Camera frame: x right, y down, z forward. A point goes there by rotation, then
translation, then `distance` along z. The image spans [-extent/2, extent/2] in u and v;
the volume spans [distance - extent/2, distance + extent/2] along z. Samples sit at cell
centres: cell i of D has coordinate ((i + 1/2)/D - 1/2)·extent.
"""

import dataclasses
import functools
import numbers
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import checks, quaternion

PROJECTIONS = ("perspective", "orthographic")
# Nearest depth with an image, in extents (heuristic): 1/z² of a nearer point would
# overflow, and make the gradient of every other input NaN.
_NEAR = 1e-6


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=("focal_length", "distance"),
    meta_fields=("projection",),
)
@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera that looks at the object's origin.

    Attributes:
      focal_length: () in units of the image plane where the paper's image is 1 wide;
        may be traced. The paper's camera has 1.875.
      distance: () from the camera to the object's origin along z; may be traced.
      projection: "perspective" or "orthographic" (no division by z); static.
    """

    focal_length: chex.Numeric = 1.875
    distance: chex.Numeric = 2.0
    projection: str = "perspective"

    def __post_init__(self):
        if self.projection not in PROJECTIONS:
            raise ValueError(
                f"Camera projection must be one of {PROJECTIONS}, but it is "
                f"{self.projection!r}; choose one of these."
            )


@dataclasses.dataclass(frozen=True)
class VoxelGrid:
    """The volume that points are rendered through; static.

    Attributes:
      shape: (rows, cols, depth), or one int for a cube.
      extent: width of the image plane and depth of the volume that the grid covers.

    Raises:
      ValueError: if a side is not a positive integer or the extent is not positive.
    """

    shape: tuple[int, int, int] | int = 64
    extent: float = 1.0

    def __post_init__(self):
        shape = self.shape
        is_one = isinstance(shape, numbers.Integral)
        sides = (shape,) * 3 if is_one else shape
        if not isinstance(sides, tuple | list) or not (
            len(sides) == 3 and all(checks.is_count(s) and s > 0 for s in sides)
        ):
            raise ValueError(
                "VoxelGrid shape must be a positive int or three of them (rows, cols, "
                f"depth), but it is {self.shape!r}; give for example VoxelGrid(64)."
            )
        is_number = isinstance(self.extent, numbers.Real) and self.extent is not True
        if not (is_number and 0 < self.extent < float("inf")):
            raise ValueError(
                "VoxelGrid extent must be a positive finite number, but it is "
                f"{self.extent!r}; the unit cube has extent 1.0."
            )
        object.__setattr__(self, "shape", tuple(int(s) for s in sides))

    def depths(self, camera: Camera, dtype=jnp.float32) -> chex.Array:
        """Metric depth z_k of each cell along a ray, [depth], nearest first."""
        size = self.shape[2]
        offsets = ((jnp.arange(size, dtype=dtype) + 0.5) / size - 0.5) * self.extent
        return offsets + jnp.asarray(camera.distance, dtype)


jax.tree_util.register_static(VoxelGrid)


class CameraPoints(NamedTuple):
    """Points in the camera's axes.

    Attributes:
      centered: [N, 3], from the middle of the volume. Depth is kept from there too:
        from a far eye it would lose the digits that place a point in the volume.
      ahead: [N] depth z from the eye.
    """

    centered: chex.Array
    ahead: chex.Array


class GridPoints(NamedTuple):
    """Points in the grid's own coordinates.

    Attributes:
      coordinates: [N, 3] continuous (row, col, depth) index; cell centres are integers.
      inside: [N] bool, whether the point lies in the volume and before the camera.
    """

    coordinates: chex.Array
    inside: chex.Array


def to_camera_frame(
    points: chex.Array,
    rotation: chex.Array,
    *,
    translation: chex.Array | None,
    camera: Camera,
) -> CameraPoints:
    """Move points [N, 3] from the object frame to the camera frame.

    The transform T_c of section "Differentiable Point Clouds", before the division.
    """
    moved = quaternion.rotate(points, rotation)
    if translation is not None:
        moved = moved + jnp.asarray(translation, points.dtype)
    return CameraPoints(moved, moved[:, 2] + jnp.asarray(camera.distance, moved.dtype))


def to_grid(points: CameraPoints, *, camera: Camera, grid: VoxelGrid) -> GridPoints:
    """Project points to grid indices; depth stays metric.

    Points behind the camera plane or within a millionth of the extent before it have
    no perspective image: they are marked outside. A point outside has zero gradient.
    """
    x, y, z = points.centered.T
    ahead = points.ahead
    is_inside = jnp.ones_like(z, bool)
    if camera.projection == "perspective":
        is_inside = ahead > _NEAR * grid.extent
    # Twice: without gradient to see where a point is, then with gradient what is
    # inside. Products with 3e38 overflow, and zero times infinity, in the derivative,
    # would be everyone's NaN.
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
    return GridPoints(coordinates=jnp.stack(coordinates, axis=-1), inside=is_inside)


def _find_fractions(x, y, z, ahead, camera, grid):
    """Place in the volume along (row, col, depth), [0, 1] inside."""
    if camera.projection == "perspective":
        inverse = jnp.asarray(camera.focal_length, z.dtype) / ahead
        x, y = x * inverse, y * inverse
    return [value / grid.extent + 0.5 for value in (y, x, z)]
