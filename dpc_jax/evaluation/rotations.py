"""Quaternions in numpy float64, for judging results after training.

The convention is that of ``dpc_jax.render.quaternion`` (wxyz, q and -q are one
rotation). A twin in numpy exists because evaluation wants float64 without switching
JAX to 64 bits, and many small arrays of different shapes without compiling for each.
"""

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
            f"Expected quaternions with 4 components (wxyz) on the last axis, got "
            f"shape {q.shape}; pass an array [..., 4]."
        )
    largest = np.max(np.abs(q), axis=-1, keepdims=True, initial=0.0)
    bad = ~(np.isfinite(largest) & (largest > 0.0))
    if np.any(bad):
        first = np.argwhere(bad[..., 0])[0].tolist()
        raise ValueError(
            f"Expected finite non-zero quaternions, got {int(bad.sum())} of {bad.size} "
            f"that are not (the first at index {first}); check the pose network's "
            f"output for divergence."
        )
    # Dividing by the largest component first keeps 1e-200 and 1e200 in range.
    q = q / largest
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def canonical_sign(quaternion: ArrayLike) -> np.ndarray:
    """The one of q and -q whose first non-zero component is positive; [..., 4]."""
    q = np.asarray(quaternion, dtype=np.float64)
    first = np.argmax(q != 0.0, axis=-1)[..., None]
    return np.where(np.take_along_axis(q, first, axis=-1) < 0.0, -q, q)


def conjugate(quaternion: ArrayLike) -> np.ndarray:
    """The inverse of unit quaternions [..., 4]."""
    return np.asarray(quaternion, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def multiply(left: ArrayLike, right: ArrayLike) -> np.ndarray:
    """Hamilton product [..., 4]: rotate by ``right`` first, then by ``left``."""
    left, right = np.asarray(left, np.float64), np.asarray(right, np.float64)
    w1, v1 = left[..., :1], left[..., 1:]
    w2, v2 = right[..., :1], right[..., 1:]
    w = w1 * w2 - np.sum(v1 * v2, axis=-1, keepdims=True)
    v = w1 * v2 + w2 * v1 + np.cross(v1, v2)
    return np.concatenate([w, v], axis=-1)


def rotation_matrix(quaternion: ArrayLike) -> np.ndarray:
    """Matrices [..., 3, 3] of quaternions [..., 4]; they need not be of unit length."""
    q = normalize(quaternion)
    matrices = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix()
    return matrices.reshape(*q.shape[:-1], 3, 3)


def from_matrix(matrix: ArrayLike) -> np.ndarray:
    """The quaternion [4], canonical in sign, of one rotation matrix [3, 3].

    The branch with the largest component is taken, so turns by exactly 180 degrees
    (where w is 0) are as accurate as any other.
    """
    q = Rotation.from_matrix(np.asarray(matrix, np.float64)).as_quat(scalar_first=True)
    return canonical_sign(q)


def rotate(quaternion: ArrayLike, points: ArrayLike) -> np.ndarray:
    """Points [..., 3] turned by one quaternion [4]."""
    return np.asarray(points, np.float64) @ rotation_matrix(quaternion).T


def angle_deg(first: ArrayLike, second: ArrayLike) -> np.ndarray:
    """Angle in degrees, 0 to 180, between rotations [..., 4] that broadcast.

    It is 2 atan2(|v|, |w|) of q1 q2^-1. Unlike 2 arccos(w) it is exact near 0, never
    NaN through rounding, and equal for q and -q.
    """
    relative = multiply(normalize(first), conjugate(normalize(second)))
    vector = np.linalg.norm(relative[..., 1:], axis=-1)
    return np.degrees(2.0 * np.arctan2(vector, np.abs(relative[..., 0])))


def mean_rotation(
    quaternions: ArrayLike, *, weights: ArrayLike | None = None
) -> np.ndarray:
    """Weighted mean rotation [4] of quaternions [n, 4].

    The eigenvector of the largest eigenvalue of the sum of w q q^T, which does not see
    the signs of the quaternions (Markley et al., Averaging Quaternions, 2007). Of two
    rotations 180 degrees apart with equal weights every one between is a mean; one of
    them, finite, is returned.
    """
    q = normalize(quaternions).reshape(-1, 4)
    w = np.ones(len(q)) if weights is None else np.asarray(weights, np.float64)
    _, vectors = np.linalg.eigh((q * w[:, None]).T @ q)
    return canonical_sign(vectors[:, -1])
