"""Renders of a data set's views beside what they should be, and their errors."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.images import color_psnr, depth_error, mean_of_known
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.signals import find_background, make_targets

MISSED = 0.1  # least share of a pixel that is hit for it to have a depth
# What `measure_images` and `measure_cameras` can find.
MEASURES = (
    "depth_error",
    "depth_error_percent",
    "color_psnr",
    "translation_error",
    "focal_length_error_percent",
)


class ViewImages(NamedTuple):
    """Images of one view by signal, [D, D] or [D, D, 3], at the size of the renders.

    Depths are of what is hit, without the background that is mixed in where they are
    compared in training: an opacity that is too low is an error of the silhouette, not
    of depth. Where less than `MISSED` is hit they are the background's. The mask is the
    share of each pixel that the object covers; of its depth, that was measured, too.
    """

    mask: np.ndarray
    measured: np.ndarray
    targets: dict[str, np.ndarray]
    rendered: dict[str, np.ndarray]


def read_view(
    predictions: Predictions, dataset: DataSet, row: int, place: int, *, distance: float
) -> ViewImages:
    """The images of one view, in the layout of predictions."""
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
        for images, share in (
            (targets, measured),
            (rendered, rendered["silhouette"]),
        ):
            images["depth"] = remove_background(images["depth"], share, background)
    return ViewImages(targets["silhouette"], measured, targets, rendered)


def remove_background(
    depth: np.ndarray, share: np.ndarray, background: float
) -> np.ndarray:
    """The depth of what is hit, from one mixed with that of the background.

    Args:
      depth: [D, D]. share: [D, D] of each pixel that is hit.
    """
    hit = np.maximum(share, MISSED)
    return np.where(
        share >= MISSED, background + (depth - background) / hit, background
    )


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
    depths, colors = [], []
    for view in _list_views(predictions, dataset, distance):
        for signal, measure, values in (
            ("depth", depth_error, depths),
            ("color", color_psnr, colors),
        ):
            if signal in view.rendered:
                pair = view.rendered[signal], view.targets[signal]
                mask = view.measured if signal == "depth" else view.mask
                values.append(measure(*pair, mask))
    metrics = {
        "depth_error": mean_of_known(depths),
        "color_psnr": mean_of_known(colors),
    }
    found = {name: value for name, value in metrics.items() if value is not None}
    if "depth_error" in found:
        found["depth_error_percent"] = 100 * found["depth_error"]
    return found


def _list_views(predictions, dataset, distance) -> Iterator[ViewImages]:
    for row, place in np.ndindex(predictions.silhouettes.shape[:2]):
        yield read_view(predictions, dataset, row, place, distance=distance)


def measure_cameras(predictions: Predictions, dataset: DataSet) -> dict[str, float]:
    """Mean errors of learned translations and focal lengths whose truth is known.

    `translation_error` is a distance in box diagonals, in the camera frame, as it is: a
    shape predicted off the centre moves every view's translation by as much.
    `focal_length_error_percent` is of the true one.
    """
    models, views = arrange_views(dataset)
    metrics = {}
    if predictions.translations is not None and dataset.translations is not None:
        true = np.asarray(dataset.translations[models, views])
        away = np.linalg.norm(predictions.translations - true, axis=-1)
        metrics["translation_error"] = float(away.mean())
    if predictions.focal_lengths is not None and dataset.focal_lengths is not None:
        true = np.asarray(dataset.focal_lengths[models, views])
        shares = np.abs(predictions.focal_lengths / true - 1)
        metrics["focal_length_error_percent"] = 100 * float(shares.mean())
    return metrics
