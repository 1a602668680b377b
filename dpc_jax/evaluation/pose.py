"""Errors of poses, what wrong ones are near to, and which candidates win."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.rotations import rotation_angle_deg

ACCURACY_THRESHOLD_DEG = 30.0  # paper, section Evaluation metrics
FLIP_THRESHOLD_DEG = 150.0  # beyond it front and back count as exchanged
KINDS = ("half turn", "other half turn", "mirror pose", "other")  # of wrong views
ALIVE_SHARE = 0.01  # of the views, which a candidate that is alive wins
_DOMINANT_SHARE = 0.95  # heuristic: beyond it the ensemble works like one regressor
_BINS = 36  # of the histogram, between 0 and 180 degrees
_ALONG, _ACROSS = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, -1.0, 1.0])


class PoseSummary(NamedTuple):
    """A summary of the pose errors of a test set."""

    accuracy: float  # share of views wrong by no more than 30 degrees, 0 to 1
    median_error_deg: float
    flip_share: float  # share of views wrong by more than 150 degrees, 0 to 1
    counts: np.ndarray  # [bins] views per bin of the histogram
    edges_deg: np.ndarray  # [bins + 1] edges of its bins, 0 to 180 degrees


def pose_summary(errors_deg: ArrayLike) -> PoseSummary:
    """Accuracy, median, share of flips and histogram of pose errors.

    Args:
      errors_deg: errors in degrees, any shape, at least one.

    Returns:
      `PoseSummary`.

    Raises:
      ValueError: there is no error, or one is not within 0 to 180 degrees.

    Example:
      >>> dpc_jax.pose_summary([10, 20, 170, 40]).accuracy
      0.5
    """
    errors = np.asarray(errors_deg, dtype=np.float64).ravel()
    # Written so that NaN fails too; the slack is for rounding of 180 degrees.
    inside = (errors >= 0.0) & (errors <= 180.0 + 1e-9)
    if errors.size == 0 or not inside.all():
        raise ValueError(
            f"Pose errors must be at least one, each between 0 and 180 degrees, but "
            f"{int((~inside).sum())} of {errors.size} are outside; take them from "
            f"rotation_angle_deg."
        )
    errors = np.minimum(errors, 180.0)
    counts, edges = np.histogram(errors, bins=_BINS, range=(0.0, 180.0))
    return PoseSummary(
        accuracy=float(np.mean(errors <= ACCURACY_THRESHOLD_DEG)),
        median_error_deg=float(np.median(errors)),
        flip_share=float(np.mean(errors > FLIP_THRESHOLD_DEG)),
        counts=counts,
        edges_deg=edges,
    )


class Failures(NamedTuple):
    """What is wrong with the poses of a test set.

    Attributes:
      errors_deg: [n, V] of the whole pose, 0 to 180.
      azimuths_deg: [n, V] of the true poses, 0 to 360; 0 looks at the front.
      kinds: [n, V] index into `KINDS` of each wrong view; -1 of right ones.
      metrics: shares from 0 to 1: `wrong_half_turn_share` and `wrong_mirror_share` of
        the wrong views, left out without any; `wrong_object_share` of the objects that
        are wrong in all their views, of which there are at least two.
    """

    errors_deg: np.ndarray
    azimuths_deg: np.ndarray
    kinds: np.ndarray
    metrics: dict[str, float]


def find_failures(predicted: ArrayLike, true: ArrayLike) -> Failures:
    """Sort the views that are wrong by more than 30° by what they are within 30° of.

    A half turn about the up axis exchanges front and back. A silhouette under
    orthographic projection is the same from the mirror pose: that of the object
    mirrored left to right, in an image mirrored along the view. For an object that is
    its own mirror image the pose K·R·M has it too, with K = diag(1, 1, -1) in the
    camera frame and M = diag(1, -1, 1) in the object's: azimuth φ becomes 180° - φ, the
    elevation changes its sign.

    Args:
      predicted, true: [n, V, 4] quaternions, object frame to camera.
    """
    found = rotations.to_rotation(predicted)
    errors = rotation_angle_deg(predicted, true)
    azimuths, _ = rotations.view_angles(true)
    wrong = errors > ACCURACY_THRESHOLD_DEG
    kinds = np.where(wrong, len(KINDS) - 1, -1)
    pose = rotations.to_rotation(true)
    front, across, up = (Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3))
    mirrored = Rotation.from_matrix(_ALONG @ pose.as_matrix() @ _ACROSS)
    # In the order of `KINDS`, of which the first that fits counts.
    alternatives = [[pose * up], [pose * front, pose * across], [mirrored]]
    for kind, others in reversed(list(enumerate(alternatives))):
        away = [np.degrees((found * other.inv()).magnitude()) for other in others]
        is_near = np.min(away, axis=0) <= ACCURACY_THRESHOLD_DEG
        kinds = np.where(wrong & is_near, kind, kinds)
    is_lost = wrong.all(axis=1) & (wrong.shape[1] > 1)
    metrics = {"wrong_object_share": float(np.mean(is_lost))}
    if wrong.any():
        metrics["wrong_half_turn_share"] = float(np.mean(kinds[wrong] == 0))
        metrics["wrong_mirror_share"] = float(np.mean(kinds[wrong] == 2))
    return Failures(errors, azimuths, kinds, metrics)


def winner_share(winners: ArrayLike, *, heads: int) -> np.ndarray:
    """Share [heads] of views that each head wins, from the winning candidates' indices.

    Candidate i is of head i % heads, turned or not.
    """
    return np.bincount(np.ravel(winners) % heads, minlength=heads) / np.size(winners)


def count_alive(shares: ArrayLike) -> int:
    """How many candidates win at least a hundredth of the views."""
    return int(np.sum(np.asarray(shares, np.float64) >= ALIVE_SHARE))


def collapse_warning(shares: ArrayLike) -> str | None:
    """A sentence if the ensemble has collapsed onto one candidate, else None.

    An ensemble of one (K = 1) has nothing to collapse.
    """
    p = np.asarray(shares, np.float64)
    if p.size <= 1:
        return None
    alive, leader = count_alive(p), int(np.argmax(p))
    if alive >= 2 and p[leader] <= _DOMINANT_SHARE:
        return None
    return (
        f"The pose ensemble has collapsed: head {leader} wins "
        f"{100 * p[leader]:.1f} % of the views and {alive} of {p.size} win at least "
        f"{100 * ALIVE_SHARE:g} %; it learns poses no better than a single "
        f"regressor. More heads (pose.num_heads) or another seed usually help."
    )
