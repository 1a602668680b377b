"""Quaternions for judging results after training: scipy's rotations, in float64.

The convention is that of `dpc_jax.render.quaternion` (wxyz; q and -q are one rotation).
Evaluation does not use that module: it wants float64 without switching JAX to 64 bits,
and many small arrays of different shapes without compiling for each.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation


def normalize(quaternion: ArrayLike) -> np.ndarray:
    """Unit quaternions [..., 4] in float64, from finite non-zero ones.

    Raises:
      ValueError: the last axis is not 4, or a quaternion is not finite or is zero. A
        zero quaternion is no rotation; scoring it as one would hide a broken network.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.ndim == 0 or q.shape[-1] != 4:
        raise ValueError(
            f"Quaternions must have 4 components (wxyz) on the last axis, but came "
            f"with shape {q.shape}; pass an array [..., 4]."
        )
    largest = np.max(np.abs(q), axis=-1, keepdims=True, initial=0.0)
    bad = ~(np.isfinite(largest) & (largest > 0.0))
    if np.any(bad):
        first = np.argwhere(bad[..., 0])[0].tolist()
        raise ValueError(
            f"Quaternions must be finite and not zero, but {int(bad.sum())} of "
            f"{bad.size} are not (the first at index {first}); check the pose "
            f"network's output for divergence."
        )
    # Squares of components of 1e-200 or 1e200 leave the range of float64.
    q = q / largest
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def to_rotation(quaternion: ArrayLike) -> Rotation:
    """scipy's rotations of quaternions [..., 4], refused as by `normalize`."""
    return Rotation.from_quat(normalize(quaternion), scalar_first=True)


def to_quaternion(rotation: Rotation) -> np.ndarray:
    """Unit quaternions [..., 4] whose first non-zero component is positive."""
    return rotation.as_quat(canonical=True, scalar_first=True)


def canonical_sign(quaternion: ArrayLike) -> np.ndarray:
    """Unit quaternions [..., 4], of which the first non-zero component is positive."""
    return to_quaternion(to_rotation(quaternion))


def rotation_angle_deg(first: ArrayLike, second: ArrayLike) -> np.ndarray:
    """Angle between rotations in degrees, 0 to 180: 2 atan2(|v|, |w|) of q1 q2^-1.

    Args:
      first, second: quaternions [..., 4], wxyz, of any length but zero; they broadcast.

    Returns:
      [...] angles. The same for q and -q, exact near 0, and never NaN.

    Raises:
      ValueError: a quaternion is zero, not finite, or has not 4 components, or the
        shapes do not broadcast.

    Example:
      >>> float(dpc_jax.rotation_angle_deg([1, 0, 0, 0], [0, 0, 0, 1]))
      180.0
    """
    try:
        np.broadcast_shapes(np.shape(first), np.shape(second))
    except ValueError as error:
        raise ValueError(
            "Expected two arrays of quaternions that broadcast, but their shapes are "
            f"{np.shape(first)} and {np.shape(second)}; pass as many of each."
        ) from error
    relative = to_rotation(first) * to_rotation(second).inv()
    return np.degrees(relative.magnitude())


def view_angles(quaternion: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths (0 to 360) and elevations in degrees of cameras, seen from the object.

    Args:
      quaternion: [..., 4], object to camera. A camera sits where its axis of view comes
        from, whatever its roll.
    """
    x, y, z = -np.moveaxis(to_rotation(quaternion).as_matrix()[..., 2, :], -1, 0)
    azimuth = np.degrees(np.arctan2(y, x)) % 360
    return azimuth, np.degrees(np.arcsin(np.clip(z, -1, 1)))


def describe_pose(quaternion: ArrayLike) -> dict[str, Any]:
    """A pose, object to camera, as JSON files have it."""
    azimuth, elevation = map(float, view_angles(quaternion))
    return {
        "quaternion": canonical_sign(quaternion).tolist(),
        "azimuth_deg": azimuth,
        "elevation_deg": elevation,
    }
