"""Scores of predictions, as far as the truth is known."""

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation import alignment as alignments
from dpc_jax.evaluation import scores
from dpc_jax.evaluation.density import count_stray_points
from dpc_jax.evaluation.images import mean_squared_difference
from dpc_jax.evaluation.pose import Failures, find_failures, winner_share
from dpc_jax.learning.inference.predictor import Predictions, arrange_views


def arrange_truth(
    dataset: DataSet,
) -> tuple[np.ndarray | None, list[np.ndarray] | None]:
    """True poses [n, V, 4] and surfaces of n models in the layout of predictions.

    Either is None where it is not given; surfaces are a list of [P, 3].
    """
    models, views = arrange_views(dataset)
    poses, surfaces = dataset.quaternions, dataset.surfaces
    return (
        None if poses is None else np.asarray(poses[models, views]),
        None if surfaces is None else [surfaces[int(m)] for m in models[:, 0]],
    )


def arrange_seen(dataset: DataSet) -> list[np.ndarray] | None:
    """Which points [P] of n surfaces can be seen; None where that is not known."""
    if dataset.seen is None or dataset.surfaces is None:
        return None
    models, _ = arrange_views(dataset)
    return [np.asarray(dataset.seen[int(m)]) for m in models[:, 0]]


def align(predictions: Predictions, dataset: DataSet) -> alignments.Alignment:
    """Canonical alignment from validation models (§ Evaluation metrics).

    Without ground truth shapes the poses alone vote, without poses there is none.
    """
    poses, surfaces = arrange_truth(dataset)
    if poses is None:
        return alignments.identity_alignment()
    if surfaces is None:
        return alignments.align_by_poses(predictions.poses, poses)
    return alignments.align(predictions.poses, poses, predictions.points, surfaces)


def score(
    predictions: Predictions,
    dataset: DataSet,
    *,
    alignment: alignments.Alignment,
    heads: int,
    poses_given: bool = False,
    chamfer_views: int | None = None,
    dense_points: int = 0,
) -> tuple[scores.Scores, np.ndarray]:
    """Scores of predictions and the share of views that each head wins.

    Metrics that need a truth which the data set lacks are left out. Where the data say
    which part of a surface can be seen, distances from and to that part have the prefix
    `visible_`. Every set gets `silhouette_iou`, the mean overlap of predicted
    silhouettes with the masks from 0 to 1; `projection_error`, the mean squared
    difference of the two per pixel, both averaged to 32×32 pixels; and `stray_points`,
    how many a predicted shape has in the mean.

    Args:
      heads: K, of the ensemble; 0 where poses are known.
      poses_given: whether the poses are those of the data, so that there is nothing
        about them to score.
      chamfer_views: views of each model that the Chamfer distance is averaged over;
        None for all.
      dense_points: see `scores.score`.
    """
    poses, surfaces = arrange_truth(dataset)
    result = scores.score(
        None if poses_given else predictions.poses,
        poses,
        predictions.points,
        surfaces,
        alignment=alignment,
        best_candidate_poses=None if poses_given else predictions.candidate_poses,
        chamfer_views=chamfer_views,
        seen=arrange_seen(dataset),
        dense_points=dense_points,
    )
    clouds = np.asarray(predictions.points)[:, :chamfer_views]
    stray = [
        count_stray_points(clouds[index]) for index in np.ndindex(clouds.shape[:2])
    ]
    found = {
        "silhouette_iou": float(measure_overlaps(predictions, dataset).mean()),
        "projection_error": measure_projection_error(predictions, dataset),
        "stray_points": float(np.mean(stray)),
    }
    result = result._replace(metrics=result.metrics | found)
    winners = predictions.winners % max(1, heads)
    shares = winner_share(winners, num_candidates=max(1, heads))
    return result, shares


def diagnose(
    predictions: Predictions, dataset: DataSet, *, alignment: alignments.Alignment
) -> Failures | None:
    """What the wrong views are; None for data without poses.

    Args:
      predictions: made with that alignment as their frame.
    """
    poses, _ = arrange_truth(dataset)
    if poses is None:
        return None
    found = alignments.align_poses(alignment, predictions.poses)
    return find_failures(found, poses, costs=predictions.costs)


def measure_projection_error(predictions: Predictions, dataset: DataSet) -> float:
    """Mean squared difference per pixel of silhouettes, each from its predicted pose.

    The figure of appendix "Towards part-based models" has it over the number of points.
    """
    models, views = arrange_views(dataset)
    errors = [
        mean_squared_difference(
            predictions.silhouettes[index],
            np.asarray(dataset.masks[models[index], views[index]]) / 255.0,
        )
        for index in np.ndindex(models.shape)
    ]
    return float(np.mean(errors))


def measure_overlaps(predictions: Predictions, dataset: DataSet) -> np.ndarray:
    """Intersection over union [n, V] of soft silhouettes with the masks, 0 to 1."""
    models, views = arrange_views(dataset)
    side = predictions.silhouettes.shape[-1]
    overlaps = np.empty(models.shape)
    for index in np.ndindex(models.shape):
        mask = np.asarray(dataset.masks[models[index], views[index]]) / 255.0
        step = mask.shape[0] // side
        target = mask.reshape(side, step, side, step).mean(axis=(1, 3))
        seen = predictions.silhouettes[index]
        union = np.maximum(seen, target).sum()
        overlaps[index] = np.minimum(seen, target).sum() / max(union, 1e-9)
    return overlaps
