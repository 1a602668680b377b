"""Predictions for a whole data set, and their scores."""

from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.config.settings import Settings
from dpc_jax.data import DataSet
from dpc_jax.evaluation import alignment as alignments
from dpc_jax.evaluation import candidates as candidate_use
from dpc_jax.evaluation import scores
from dpc_jax.learning import hindsight, losses, schedules
from dpc_jax.learning.objective import complete_poses, compute_mass, scale_images
from dpc_jax.learning.step import TrainState
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera, VoxelGrid, project


class Predictions(NamedTuple):
    """What the network says of M models with V views each, in its own frame.

    Attributes:
      points: [M, V, N, 3], the shape predicted from each view.
      colors: [M, V, N, 3], or None.
      poses: [M, V, 4], the student's quaternion; the given one where poses are known.
      candidate_poses: [M, V, 4], the candidate, turned or not, that fits the view best.
      winners: [M, V] its index; turned or not, it is head index % K's.
      silhouettes: [M, V, D, D], the shape seen from the student's pose.
    """

    points: np.ndarray
    colors: np.ndarray | None
    poses: np.ndarray
    candidate_poses: np.ndarray
    winners: np.ndarray
    silhouettes: np.ndarray


def make_predictor(network: ShapePoseNetwork, settings: Settings):
    """The compiled function (state, images, masks, quaternions) -> dict.

    For n views: images uint8 [n, S, S, 3], masks uint8 [n, S, S], quaternions [n, 4].
    """
    camera = Camera(settings.focal_length, settings.distance)
    grid = VoxelGrid(settings.fine_grid or settings.grid)
    ratio = grid.shape[0] / settings.grid

    def predict(state, images, masks, quaternions):
        output = network.apply(state.params, scale_images(images))
        if settings.num_candidates:
            output = complete_poses(output, state.covariance, settings)
        sigma = schedules.compute_sigma(state.step, settings)
        mass = compute_mass(output["scale"], sigma, settings)
        targets = losses.downsample_images(masks, settings.grid)
        candidates = output.get("candidates", quaternions[:, None])
        poses = output.get("student", quaternions)

        def explain(view):
            points, view_mass, pose, view_candidates, target = view
            image = project(
                points,
                pose,
                sigma=sigma * ratio,
                scale=view_mass * ratio**3,
                camera=camera,
                grid=grid,
            )
            if view_candidates.shape[0] == 1:
                return image.silhouette, 0
            winner = hindsight.choose_candidate(
                points,
                view_mass,
                view_candidates,
                target,
                sigma=sigma,
                camera=camera,
                at_once=settings.renders_at_once,
            )
            return image.silhouette, winner

        silhouettes, winners = hindsight.map_renders(
            explain,
            (output["points"], mass, poses, candidates, targets),
            at_once=settings.renders_at_once,
        )
        best = jax.vmap(lambda q, k: q[k])(candidates, winners)
        result = {
            "points": output["points"],
            "poses": poses,
            "candidate_poses": best,
            "winners": winners,
            "silhouettes": silhouettes,
        }
        if "colors" in output:
            result["colors"] = output["colors"]
        return result

    return jax.jit(predict)


def arrange_views(dataset: DataSet) -> tuple[np.ndarray, np.ndarray]:
    """Indices (models, views) [n, V] of all views, in the layout of predictions.

    Where models differ in their number of views each view stands alone: V is 1 and n
    counts views.
    """
    counts = dataset.counts
    models = np.repeat(np.arange(len(counts)), counts)
    views = np.arange(len(models)) - np.repeat(np.cumsum(counts) - counts, counts)
    width = counts[0] if (counts == counts[0]).all() else 1
    return models.reshape(-1, width), views.reshape(-1, width)


def predict_all(
    predictor,
    state: TrainState,
    dataset: DataSet,
    *,
    views_at_once: int = 64,
) -> Predictions:
    """Run the predictor over a data set in equal batches (the last one is padded).

    Views are read batch by batch: a set may be larger than the memory. The layout is
    that of `arrange_views`; poses that are not given are the identity.
    """
    models, views = arrange_views(dataset)
    total = models.size

    parts = []
    for start in range(0, total, views_at_once):
        rows = np.minimum(np.arange(start, start + views_at_once), total - 1)
        chosen = models.reshape(-1)[rows], views.reshape(-1)[rows]
        if dataset.quaternions is None:
            poses = np.tile(np.float32([1, 0, 0, 0]), (views_at_once, 1))
        else:
            poses = np.asarray(dataset.quaternions[chosen])
        images, masks = dataset.images[chosen], dataset.masks[chosen]
        output = predictor(state, np.asarray(images), np.asarray(masks), poses)
        parts.append(jax.device_get(output))
    merged = {
        name: np.concatenate([p[name] for p in parts])[:total].reshape(
            *models.shape, *parts[0][name].shape[1:]
        )
        for name in parts[0]
    }
    return Predictions(colors=merged.pop("colors", None), **merged)


def arrange_truth(dataset: DataSet):
    """True poses [n, V, 4] and surfaces of n models in the layout of predictions.

    Either is None where it is not given; surfaces are a list of [P, 3].
    """
    models, views = arrange_views(dataset)
    poses, surfaces = dataset.quaternions, dataset.surfaces
    return (
        None if poses is None else np.asarray(poses[models, views]),
        None if surfaces is None else [surfaces[int(m)] for m in models[:, 0]],
    )


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
    num_candidates: int,
    chamfer_views: int | None = None,
) -> tuple[scores.Scores, np.ndarray]:
    """Scores of predictions and the share of views that each head wins.

    What there is no truth for is left out of the metrics. Then, as a measure that needs
    none, they have ``silhouette_iou``, the mean overlap of predicted silhouettes with
    the masks, 0 to 1.
    """
    poses, surfaces = arrange_truth(dataset)
    result = scores.score(
        predictions.poses,
        poses,
        predictions.points,
        surfaces,
        alignment=alignment,
        best_candidate_poses=predictions.candidate_poses,
        chamfer_views=chamfer_views,
    )
    if poses is None or surfaces is None:
        overlap = measure_overlap(predictions, dataset)
        result = result._replace(metrics=result.metrics | {"silhouette_iou": overlap})
    heads = predictions.winners % max(1, num_candidates)
    shares = candidate_use.winner_share(heads, num_candidates=max(1, num_candidates))
    return result, shares


def measure_overlap(predictions: Predictions, dataset: DataSet) -> float:
    """Mean intersection over union of soft silhouettes with the masks."""
    models, views = arrange_views(dataset)
    side = predictions.silhouettes.shape[-1]
    overlaps = []
    for index in np.ndindex(models.shape):
        mask = np.asarray(dataset.masks[models[index], views[index]]) / 255.0
        step = mask.shape[0] // side
        target = mask.reshape(side, step, side, step).mean(axis=(1, 3))
        seen = predictions.silhouettes[index]
        union = np.maximum(seen, target).sum()
        overlaps.append(np.minimum(seen, target).sum() / max(union, 1e-9))
    return float(np.mean(overlaps))
