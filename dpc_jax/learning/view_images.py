"""Renders of a data set's views beside what they should be, and their errors."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.images import color_psnr, depth_error, mean_of_known
from dpc_jax.learning.predictor import Predictions, arrange_views
from dpc_jax.learning.signals import make_targets

# What `measure_images` and `measure_cameras` can find.
MEASURES = (
    "depth_error",
    "depth_error_percent",
    "color_psnr",
    "translation_error",
    "focal_length_error_percent",
)


class ViewImages(NamedTuple):
    """Images of one view by signal, [D, D] or [D, D, 3], at the size of the renders."""

    mask: np.ndarray
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
    return ViewImages(targets["silhouette"], targets, rendered)


def measure_images(
    predictions: Predictions, dataset: DataSet, *, distance: float
) -> dict[str, float]:
    """Mean over the views of depth error and colour PSNR, those that there are.

    Depths are seen from the predicted pose, so an error of the pose is one of depth;
    `depth_error_percent` is in hundredths of the object's box diagonal, which is 1.
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
                values.append(measure(*pair, _find_measured(view, signal, distance)))
    metrics = {
        "depth_error": mean_of_known(depths),
        "color_psnr": mean_of_known(colors),
    }
    found = {name: value for name, value in metrics.items() if value is not None}
    if "depth_error" in found:
        found["depth_error_percent"] = 100 * found["depth_error"]
    return found


def _find_measured(view, signal, distance):
    """The mask of a signal; a covered pixel of background depth was not measured."""
    if signal != "depth":
        return view.mask
    return np.where(view.targets["depth"] < distance + 0.5, view.mask, 0)


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
