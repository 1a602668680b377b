"""Pose error: the angle between predicted and true rotation, and its summary."""

import numbers
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation import rotations

ACCURACY_THRESHOLD_DEG = 30.0  # paper, section Evaluation metrics
FLIP_THRESHOLD_DEG = 150.0  # beyond it front and back count as exchanged


class PoseSummary(NamedTuple):
    """A summary of the pose errors of a test set."""

    accuracy: float  # share of views within the threshold, 0 to 1
    median_error_deg: float
    flip_share: float  # share of views wrong by more than 150 degrees, 0 to 1
    counts: np.ndarray  # [bins] views per bin of the histogram
    edges_deg: np.ndarray  # [bins + 1] edges of its bins, 0 to 180 degrees


def rotation_angle_deg(first: ArrayLike, second: ArrayLike) -> np.ndarray:
    """Angle between rotations in degrees, 0 to 180: 2 atan2(|v|, |w|) of q1 q2^-1.

    Args:
      first, second: quaternions [..., 4], wxyz, of any length but zero; they broadcast.

    Returns:
      [...] angles. The same for q and -q, and never NaN.

    Raises:
      ValueError: a quaternion is zero, not finite, or has not 4 components, or the
        shapes do not broadcast.
    """
    try:
        np.broadcast_shapes(np.shape(first), np.shape(second))
    except ValueError as error:
        raise ValueError(
            "Expected two arrays of quaternions that broadcast, but their shapes are "
            f"{np.shape(first)} and {np.shape(second)}; pass as many of each."
        ) from error
    return rotations.angle_deg(first, second)


def pose_accuracy(
    errors_deg: ArrayLike, *, threshold_deg: float = ACCURACY_THRESHOLD_DEG
) -> float:
    """Share of errors within the threshold (paper, section Evaluation metrics)."""
    return float(np.mean(_check_errors(errors_deg) <= threshold_deg))


def pose_summary(
    errors_deg: ArrayLike,
    *,
    threshold_deg: float = ACCURACY_THRESHOLD_DEG,
    bins: int = 36,
) -> PoseSummary:
    """Accuracy, median, share of flips and histogram of pose errors.

    Args:
      errors_deg: errors in degrees, any shape, at least one.
      threshold_deg: an error up to it counts as right.
      bins: equal bins of the histogram between 0 and 180 degrees.

    Raises:
      ValueError: there is no error, or one is not within 0 to 180 degrees, or there
        are no bins, or the threshold is not a number.
    """
    errors = _check_errors(errors_deg)
    if not (isinstance(bins, numbers.Integral) and bins > 0 and threshold_deg >= 0):
        raise ValueError(
            "bins must be a positive integer, and a threshold at least 0 degrees, but "
            f"they are {bins!r} and {threshold_deg!r}; leave them out for 36 and 30."
        )
    counts, edges = np.histogram(errors, bins=bins, range=(0.0, 180.0))
    return PoseSummary(
        accuracy=pose_accuracy(errors, threshold_deg=threshold_deg),
        median_error_deg=float(np.median(errors)),
        flip_share=float(np.mean(errors > FLIP_THRESHOLD_DEG)),
        counts=counts,
        edges_deg=edges,
    )


def _check_errors(errors_deg: ArrayLike) -> np.ndarray:
    errors = np.asarray(errors_deg, dtype=np.float64).ravel()
    # Written so that NaN fails too; the slack is for rounding of 180 degrees.
    inside = (errors >= 0.0) & (errors <= 180.0 + 1e-9)
    if errors.size == 0 or not inside.all():
        raise ValueError(
            f"Pose errors must be at least one, each between 0 and 180 degrees, but "
            f"{int((~inside).sum())} of {errors.size} are outside; take them from "
            f"rotation_angle_deg."
        )
    return np.minimum(errors, 180.0)
