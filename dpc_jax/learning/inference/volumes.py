"""Points of predicted volumes, so that voxel models are judged as point clouds are."""

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation import surfaces
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.learning.inference.predictor import Predictions, arrange_views

FIRST_THRESHOLD = 0.4  # before it is tuned
_SHAPES = 20  # validation shapes that it is tuned on, as many as align


def add_points(
    predictions: Predictions, threshold: float, *, count: int = surfaces.SAMPLES
) -> Predictions:
    """Predictions with samples of the surfaces of their cells as points."""
    cells = predictions.cells
    assert cells is not None
    points = np.empty((*cells.shape[:2], count, 3), np.float32)
    for place in np.ndindex(cells.shape[:2]):
        points[place] = surfaces.sample_surface(cells[place], threshold, count=count)
    return predictions._replace(points=points)


def choose_threshold(
    predictions: Predictions, dataset: DataSet, alignment: Alignment
) -> float:
    """The threshold of the least Chamfer distance on validation shapes.

    Args:
      predictions: for the set, with cells. dataset: with true surfaces.
      alignment: from the network's frame to that of the surfaces.
    """
    cells = predictions.cells
    assert cells is not None
    models, _ = arrange_views(dataset)
    chosen = range(min(_SHAPES, len(models)))
    turned = [
        # Into the network's frame, where the cells are.
        align_points(_invert(alignment), np.asarray(dataset.surfaces[int(m)]))
        for m in models[: len(chosen), 0]
    ]
    return surfaces.tune_threshold([cells[row, 0] for row in chosen], turned)


def _invert(alignment):
    conjugate = np.array([1, -1, -1, -1]) * alignment.rotation
    return alignment._replace(rotation=conjugate)
