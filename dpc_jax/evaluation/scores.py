"""All metrics of a test set at once: poses, and shapes in the paper's units."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation.alignment import Alignment, align_points, align_poses
from dpc_jax.evaluation.chamfer import Chamfer, Surface
from dpc_jax.evaluation.metrics import STDERR
from dpc_jax.evaluation.pose import (
    ACCURACY_THRESHOLD_DEG,
    Failures,
    find_failures,
    pose_summary,
)
from dpc_jax.evaluation.rotations import rotation_angle_deg

_DRAWS = 1000  # of objects
ASKED = 10_000  # points of a visible surface whose distance to a cloud is taken


class Scores(NamedTuple):
    """The scores of a network on a test set; None where the truth is not known.

    Metrics are plain floats: `pose_accuracy` (0 to 1) and `pose_median_error_deg`, also
    of the best candidate (`best_candidate_`), `flip_share` (0 to 1), and `chamfer`,
    `precision` and `coverage` (times 100), also of what can be seen of a surface
    (`visible_`).
    """

    metrics: dict[str, float]
    # [n, views scored, 2] precision and coverage, object units, not times 100
    chamfers: np.ndarray | None = None
    failures: Failures | None = None  # of the predicted poses, with their errors
    visible_chamfers: np.ndarray | None = None  # as `chamfers`, of what can be seen


def score(
    predicted_poses: ArrayLike | None,
    true_poses: ArrayLike | None,
    points: ArrayLike,
    surfaces: Sequence[ArrayLike] | np.ndarray | None,
    *,
    alignment: Alignment,
    best_candidate_poses: ArrayLike | None = None,
    chamfer_views: int | None = None,
    visible: Iterable[ArrayLike] | None = None,
) -> Scores:
    """Score predictions on a test set (paper, section Evaluation metrics).

    Distances are means over models and views.

    Args:
      predicted_poses: [n, V, 4] quaternions, network's frame to camera. None where they
        were given and not predicted: poses are not scored then.
      true_poses: [n, V, 4] object frame to camera. None: nothing is scored, because
        the alignment needs them.
      points: [n, V, N, 3] shape predicted from each view, in the network's frame.
      surfaces: [n, P, 3] points of the true surfaces, object frame, or a list of
        [P_i, 3]. Few points far apart would raise precision. None: no shape is scored.
      alignment: from `align` on validation models.
      best_candidate_poses: [n, V, 4] the ensemble's winner for each view, or None where
        there is no ensemble.
      chamfer_views: shapes of only the first this many views are compared; all if None.
      visible: [P', 3] points of each surface that can be seen from outside; None: not
        known.

    Raises:
      ValueError: quaternions that are zero or not finite; points that are not finite.
    """
    if true_poses is None:
        return Scores({})
    metrics, failures = {}, None
    if predicted_poses is not None:
        aligned = align_poses(alignment, predicted_poses)
        failures = find_failures(aligned, true_poses)
        summary = pose_summary(failures.errors_deg)
        metrics = {
            "pose_accuracy": summary.accuracy,
            "pose_median_error_deg": summary.median_error_deg,
            "flip_share": summary.flip_share,
        }
    if best_candidate_poses is not None:
        best_poses = align_poses(alignment, best_candidate_poses)
        best = pose_summary(rotation_angle_deg(best_poses, true_poses))
        metrics["best_candidate_pose_accuracy"] = best.accuracy
        metrics["best_candidate_pose_median_error_deg"] = best.median_error_deg

    if surfaces is None:
        return Scores(metrics, failures=failures)
    clouds = align_points(alignment, np.asarray(points)[:, :chamfer_views])
    truths = (Surface(p, name=f"surface of model {i}") for i, p in enumerate(surfaces))
    found = {"": _compare(clouds, truths)}
    if visible is not None:
        found["visible_"] = _compare(clouds, (Surface(p, asked=ASKED) for p in visible))
    for prefix, distances in found.items():
        mean = Chamfer(*distances.mean(axis=(0, 1)).tolist()).in_paper_units()
        metrics |= {prefix + name: value for name, value in mean.items()}
    return Scores(metrics, found[""], failures, found.get("visible_"))


def _compare(clouds: np.ndarray, surfaces: Iterable[Surface]) -> np.ndarray:
    """Precision and coverage [n, V, 2] of clouds [n, V, N, 3], by their surfaces."""
    pairs = zip(clouds, surfaces, strict=True)
    return np.array([[truth.compare(c) for c in views] for views, truth in pairs])


def estimate_errors(scores: Scores) -> dict[str, float]:
    """Standard errors of metrics, named with `STDERR`: were other objects drawn.

    By a bootstrap over the objects, whose views are not independent.
    """
    found = {}
    if scores.failures is not None:
        errors = scores.failures.errors_deg
        found["pose_accuracy"] = _resample(errors <= ACCURACY_THRESHOLD_DEG, np.mean)
        found["pose_median_error_deg"] = _resample(errors, np.median)
    if scores.chamfers is not None:
        found["chamfer"] = _resample(100 * scores.chamfers.sum(axis=-1), np.mean)
    if scores.visible_chamfers is not None:
        sums = 100 * scores.visible_chamfers.sum(axis=-1)
        found["visible_chamfer"] = _resample(sums, np.mean)
    return {name + STDERR: value for name, value in found.items()}


def _resample(values, measure) -> float:
    count = len(values)
    drawn = np.random.default_rng(0).integers(count, size=(_DRAWS, count))
    return float(np.std(measure(values[drawn], axis=(1, 2))))
