"""Viewpoints: camera rotations from azimuth and elevation, and as quaternions."""

import numpy as np


def look_at_rotation(azimuth, elevation):
    """Rotation from the object to a camera that looks at the origin, image upright.

    The camera sits in the direction (cos el cos az, cos el sin az, sin el) of the
    object frame (z up); its axes are x right, y down, z forward.

    Args:
      azimuth: radians, from +x towards +y.
      elevation: radians above the xy plane, strictly between -pi/2 and pi/2.

    Returns:
      [3, 3] float64, rows are the camera axes in the object frame.

    Raises:
      ValueError: for an elevation at a pole, where "upright" has no meaning.
    """
    if not abs(elevation) < np.pi / 2 - 1e-9:
        raise ValueError(
            "elevation must lie strictly between -pi/2 and pi/2 because a camera at a "
            f"pole has no upright direction, got {elevation}; move it off the pole."
        )
    cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
    cos_e, sin_e = np.cos(elevation), np.sin(elevation)
    forward = -np.array([cos_e * cos_a, cos_e * sin_a, sin_e])
    right = np.array([-sin_a, cos_a, 0.0])  # forward x up, already of unit length
    down = np.cross(forward, right)
    return np.stack([right, down, forward])


def matrix_to_quaternion(rotation):
    """Quaternion [4] (wxyz, w >= 0) of a rotation matrix [3, 3].

    Of the four possible formulas the one with the largest divisor is used, so that
    no rotation (180 degrees included) loses digits.
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = np.trace(r)
    # four times the squares of w, x, y, z; at least one of them is >= 1
    squares = 1.0 + np.array(
        [trace, *(2.0 * r[i, i] - trace for i in range(3))], dtype=np.float64
    )
    products = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], squares[2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[3]],
        ]
    )
    quaternion = products[np.argmax(squares)]
    quaternion = quaternion / np.linalg.norm(quaternion)
    return -quaternion if quaternion[0] < 0 else quaternion
