"""Scores of predictions, as far as the truth is known."""

from typing import Any

import jax
import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation import alignment as alignments
from dpc_jax.evaluation import images, scores
from dpc_jax.evaluation.chamfer import count_stray_points
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.signals import find_background, make_targets


def arrange_truth(dataset: DataSet) -> tuple[Any, Any, Any]:
    """True poses [n, V, 4] and surfaces of n models in the layout of predictions.

    Surfaces are a list of [P, 3]. What can be seen of them, [P', 3] each, is read one
    by one and once. Each of the three is None where it is not given.
    """
    models, views = arrange_views(dataset)
    first = models[:, 0].tolist()
    poses, surfaces = dataset.quaternions, dataset.surfaces
    return (
        None if poses is None else np.asarray(poses[models, views]),
        None if surfaces is None else [surfaces[model] for model in first],
        None if dataset.visible is None else map(dataset.read_visible, first),
    )


def align(*shown: tuple[Predictions, DataSet]) -> alignments.Alignment:
    """Canonical alignment from predictions for data sets; without poses there is none.

    Models of the first set stand first; all have equally many views.
    """
    predictions, sets = zip(*shown, strict=True)
    poses, surfaces, _ = zip(*map(arrange_truth, sets), strict=True)
    if any(given is None for given in poses):
        return alignments.identity_alignment()
    return alignments.align(
        np.concatenate([found.poses for found in predictions]),
        np.concatenate(poses),
        np.concatenate([found.points for found in predictions]),
        None if any(s is None for s in surfaces) else sum(surfaces, []),
    )


def score(
    predictions: Predictions,
    dataset: DataSet,
    *,
    alignment: alignments.Alignment,
    poses_given: bool = False,
    chamfer_views: int | None = None,
    has_visible: bool = True,
) -> scores.Scores:
    """Scores of predictions; metrics whose truth the data set lacks are left out.

    Where the data say what can be seen of a surface, distances from and to that have
    the prefix `visible_`. Every set gets `silhouette_iou`, the mean overlap
    of predicted silhouettes with the masks from 0 to 1; `projection_error`, the mean
    squared difference of the two per pixel, averaged to 32×32 pixels (appendix "Towards
    part-based models"); and `stray_points`, how many a predicted shape has in the mean.

    Args:
      poses_given: whether the poses are those of the data, so that there is nothing
        about them to score.
      chamfer_views: see `scores.score`.
      has_visible: whether visible surfaces are compared, too; few points of one, as
        validation shapes have, make its distances longer.
    """
    poses, surfaces, visible = arrange_truth(dataset)
    winners = np.asarray(predictions.winners)[..., None, None]
    best = np.take_along_axis(predictions.candidates, winners, axis=2)[:, :, 0]
    result = scores.score(
        None if poses_given else predictions.poses,
        poses,
        predictions.points,
        surfaces,
        alignment=alignment,
        best_candidate_poses=None if poses_given else best,
        chamfer_views=chamfer_views,
        visible=visible if has_visible else None,
    )
    clouds = np.asarray(predictions.points)[:, :chamfer_views]
    stray = [count_stray_points(cloud) for row in clouds for cloud in row]
    overlaps, errors = np.moveaxis(compare_silhouettes(predictions, dataset), -1, 0)
    found = {
        "silhouette_iou": float(overlaps.mean()),
        "projection_error": float(errors.mean()),
        "stray_points": float(np.mean(stray)),
    }
    return result._replace(metrics=result.metrics | found)


def compare_silhouettes(predictions: Predictions, dataset: DataSet) -> np.ndarray:
    """Intersection over union, 0 to 1, and mean squared difference [n, V, 2].

    Of soft silhouettes and the masks.
    """
    models, views = arrange_views(dataset)
    found = np.empty((*models.shape, 2))
    for index in np.ndindex(models.shape):
        mask = np.asarray(dataset.masks[models[index], views[index]]) / 255.0
        predicted = predictions.silhouettes[index]
        target = images.resize(mask, len(predicted))
        found[index] = (
            images.measure_overlap(predicted, target),
            images.mean_squared_difference(predicted, mask),
        )
    return found


def read_view(
    predictions: Predictions, dataset: DataSet, row: int, place: int, *, distance: float
) -> images.ViewImages:
    """Renders of one view, in the layout of predictions, and what they should be."""
    models, views = arrange_views(dataset)
    found = {
        "silhouette": predictions.silhouettes,
        "depth": None if dataset.depths is None else predictions.depths,
        "color": predictions.color_images,
    }
    rendered = {n: a[row, place] for n, a in found.items() if a is not None}
    side = predictions.silhouettes.shape[-1]
    arrays = {
        name: np.asarray(getattr(dataset, name)[models[row, place], views[row, place]])
        for name in ("masks", "images", "depths")
        if getattr(dataset, name) is not None
    }
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        made = make_targets(arrays, side, signals=tuple(rendered), distance=distance)
    targets = {name: np.asarray(image) for name, image in made.items()}
    measured = targets.pop("measured", targets["silhouette"])
    if "depth" in rendered:
        background = find_background(distance)
        for shown, share in ((targets, measured), (rendered, rendered["silhouette"])):
            away = (shown["depth"] - background) / np.maximum(share, images.MISSED)
            is_hit = share >= images.MISSED
            shown["depth"] = np.where(is_hit, background + away, background)
    return images.ViewImages(measured, targets, rendered)


def measure_images(
    predictions: Predictions, dataset: DataSet, *, distance: float
) -> dict[str, float]:
    """Mean over the views of depth error and colour PSNR, those that there are.

    Depths are seen from the predicted pose, so an error of the pose is one of depth;
    `depth_error_percent` is in hundredths of the object's box diagonal, which is 1. A
    pixel that the prediction misses has the error of the background.
    """
    if predictions.depths is None and predictions.color_images is None:
        return {}
    found: dict[str, list] = {"depth_error": [], "color_psnr": []}
    for row, place in np.ndindex(predictions.silhouettes.shape[:2]):
        view = read_view(predictions, dataset, row, place, distance=distance)
        rendered, true = view.rendered, view.targets
        if "depth" in rendered:
            error = images.depth_error(rendered["depth"], true["depth"], view.measured)
            found["depth_error"].append(error)
        if "color" in rendered:
            pair = rendered["color"], true["color"]
            ratio = images.color_psnr(*pair, true["silhouette"])
            found["color_psnr"].append(ratio)
    known = {n: [v for v in values if v is not None] for n, values in found.items()}
    metrics = {n: float(np.mean(values)) for n, values in known.items() if values}
    if "depth_error" in metrics:
        metrics["depth_error_percent"] = 100 * metrics["depth_error"]
    return metrics


def measure_cameras(predictions: Predictions, dataset: DataSet) -> dict[str, float]:
    """Mean errors of learned translations and focal lengths whose truth is known.

    `translation_error` is a distance in box diagonals, in the camera frame, as it is: a
    shape predicted off the centre moves every view's translation by as much.
    `focal_length_error_percent` is of the true one.
    """
    views, metrics = arrange_views(dataset), {}
    found, true = predictions.translations, dataset.translations
    if found is not None and true is not None:
        away = np.linalg.norm(found - np.asarray(true[views]), axis=-1)
        metrics["translation_error"] = float(away.mean())
    found, true = predictions.focal_lengths, dataset.focal_lengths
    if found is not None and true is not None:
        shares = np.abs(found / np.asarray(true[views]) - 1)
        metrics["focal_length_error_percent"] = 100 * float(shares.mean())
    return metrics
