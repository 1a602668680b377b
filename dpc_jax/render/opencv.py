"""Cameras as OpenCV has them: K in pixels and a world-to-camera matrix.

A pixel is u = f_x·x/z + c_x, v = f_y·y/z + c_y for a point (x, y, z) = R·p + t.
"""

from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from dpc_jax.render import checks, quaternion
from dpc_jax.render.camera import Camera, VoxelGrid


class OpenCVView(NamedTuple):
    """What an OpenCV camera sees; the fields are arguments of `project`.

    Attributes:
      rotation: [3, 3], object to camera. translation: [3], in the camera frame.
      camera: its distance is that of the object, its lengths are in image widths.
      grid: of the image's rows and columns.
    """

    rotation: Any
    translation: Any
    camera: Camera
    grid: VoxelGrid


def from_opencv(
    K: ArrayLike,  # noqa: N803  its name everywhere
    world_to_camera: ArrayLike,
    *,
    width: int,
    height: int,
    center: ArrayLike | None = None,
    radius: ArrayLike = 0.5,
    depth: int | None = None,
) -> OpenCVView:
    """What `project` takes to draw the image of an OpenCV camera.

    The object frame is the world's, moved and scaled so that its unit cube is 2·radius
    wide about the center: p_object = (p_world - center) / (2·radius). Depths that
    `project` gives are in the object's unit; times 2·radius they are the world's.

    Args:
      K: [3, 3], focal lengths and principal point in pixels, without skew. The middle
        of the first pixel is (0, 0). COLMAP and NeRF tools call it (0.5, 0.5): subtract
        0.5 from their c_x and c_y.
      world_to_camera: [3, 4] or [4, 4]; the camera has x right, y down, z forward.
      width, height: of the image in pixels; static.
      center: [3], of the object in the world; None for the world's origin.
      radius: (), half the cube's side.
      depth: cells along the rays; static. None for the larger side of the image.

    Returns:
      Rotation, translation, camera and grid, for `project`. What is traced has
      gradients; what is known is computed in float64, far from the origin too.

    Raises:
      ValueError: for matrices of other shapes, a skew, a matrix that does not begin
        with a rotation, lengths that are not finite and positive.

    Example:
      >>> K = np.array([[110.0, 0, 50.3], [0, 118, 30.1], [0, 0, 1]])
      >>> matrix = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2.5]])
      >>> view = dpc_jax.from_opencv(K, matrix, width=96, height=64, radius=0.8)
      >>> images = dpc_jax.project(jnp.zeros((1, 3)), **view._asdict(), sigma=1.0)
      >>> images.silhouette.shape
      (64, 96)
    """
    cells = max(width, height) if depth is None else depth
    grid = VoxelGrid((height, width, cells))
    given: dict[str, Any] = {"K": K, "world_to_camera": world_to_camera}
    given |= {"center": np.zeros(3) if center is None else center, "radius": radius}
    shapes = {"world_to_camera": ((3, 4), (4, 4)), "center": ((3,),), "radius": ((),)}
    for name, value in given.items():
        checks.check_real(name, value, *shapes.get(name, ((3, 3),)))
    is_known = all(map(checks.is_known, given.values()))
    numpy: ModuleType | Any = np if is_known else jnp
    if is_known:
        given = {name: np.asarray(value, float) for name, value in given.items()}
        checks.check_values(given)
    lens, matrix, origin, half = (numpy.asarray(value) for value in given.values())
    turn = matrix[:3, :3]
    x, y, z = ((turn * origin[None]).sum(axis=1) + matrix[:3, 3]) / (2 * half)
    wide, tall = lens[0, 0] / width, lens[1, 1] / height
    middle = (lens[0, 2] + 0.5) / width - 0.5, (lens[1, 2] + 0.5) / height - 0.5
    camera = Camera(wide, z, "perspective", numpy.stack(middle), tall / wide)
    return OpenCVView(turn, numpy.stack([x, y, 0 * z]), camera, grid)


def to_opencv(
    rotation: ArrayLike,
    *,
    translation: ArrayLike | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(),
    center: ArrayLike | None = None,
    radius: ArrayLike = 0.5,
) -> tuple[jax.Array, jax.Array]:
    """The way back from `from_opencv`.

    Args:
      rotation: [4] quaternion or [3, 3].
      translation, camera, grid: as of `project`.
      center: [3], of the object in the world; None for the world's origin.
      radius: (), half the side of its cube.

    Returns:
      (K [3, 3] in pixels, world_to_camera [3, 4]).

    Raises:
      ValueError: for an orthographic camera, and other shapes.

    Example:
      >>> K, world_to_camera = dpc_jax.to_opencv(jnp.eye(3), grid=dpc_jax.VoxelGrid(32))
      >>> K[0].tolist()
      [60.0, 0.0, 15.5]
    """
    if camera.projection != "perspective":
        raise ValueError(
            "camera must be a perspective one, for which K stands, but its projection "
            f"is {camera.projection!r}; leave the projection out."
        )
    turn = checks.check_real("rotation", rotation, (4,), (3, 3))
    turn = quaternion.to_matrix(turn) if turn.ndim == 1 else turn
    rows, cols, _ = grid.shape
    middle = (0.0, 0.0) if camera.principal_point is None else camera.principal_point
    u, v = jnp.asarray(middle)
    wide = jnp.asarray(camera.focal_length) / grid.extent
    tall = wide * (1.0 if camera.aspect is None else camera.aspect)
    middle = (u / grid.extent + 0.5) * cols - 0.5, (v / grid.extent + 0.5) * rows - 0.5
    lens = jnp.array(
        [[wide * cols, 0, middle[0]], [0, tall * rows, middle[1]], [0, 0, 1]]
    )
    place = jnp.zeros(3) if translation is None else jnp.asarray(translation)
    place = 2 * radius * place.at[2].add(camera.distance)
    if center is not None:
        place = place - jnp.matmul(turn, jnp.asarray(center), precision="highest")
    return lens, jnp.concatenate([turn, place[:, None]], axis=1)
