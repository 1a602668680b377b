"""Viewpoints: camera rotations from azimuth and elevation, and as quaternions."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

# Azimuth and elevation in degrees of the corners of a cube.
CORNERS = tuple(
    (45 + 90 * number, sign * np.rad2deg(np.arcsin(1 / np.sqrt(3))))
    for sign in (1, -1)
    for number in range(4)
)


def look_at_rotation(azimuth: float, elevation: float) -> np.ndarray:
    """Rotation [3, 3] from the object to a camera that looks at the origin, upright.

    The camera sits in the direction (cos el cos az, cos el sin az, sin el) of the
    object frame (z up); its axes are x right, y down, z forward. Angles are radians.
    """
    cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
    cos_e, sin_e = np.cos(elevation), np.sin(elevation)
    forward = -np.array([cos_e * cos_a, cos_e * sin_a, sin_e])
    right = np.array([-sin_a, cos_a, 0.0])  # forward x up, already of unit length
    down = np.cross(forward, right)
    return np.stack([right, down, forward])


def matrix_to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Quaternions [..., 4] (wxyz, w >= 0) of rotation matrices [..., 3, 3]."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def stack_views(views: Iterable[tuple]) -> dict[str, np.ndarray]:
    """Arrays of a model from (image, mask, depth, rotation [3, 3]) of its views."""
    images, masks, depths, rotations = map(np.stack, zip(*views, strict=True))
    return {
        "images": images.astype(np.uint8),
        "masks": masks.astype(np.uint8),
        "depths": depths.astype(np.float32),
        "quaternions": matrix_to_quaternion(rotations).astype(np.float32),
    }
