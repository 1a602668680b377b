"""Points of predicted volumes, so that voxel models are judged as point clouds are."""

from collections.abc import Callable

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


def find_threshold(
    predictions: Predictions,
    validation: DataSet,
    align: Callable[[Predictions], Alignment],
) -> float:
    """The threshold of the least Chamfer distance of surfaces to validation shapes.

    Args:
      predictions: for the validation split.
      validation: that split. Without true shapes the threshold stays the first one.
      align: of predictions with points.
    """
    threshold, cells = FIRST_THRESHOLD, predictions.cells
    if validation.surfaces is not None and cells is not None:
        alignment = align(add_points(predictions, threshold, count=2000))
        conjugate = np.array([1, -1, -1, -1]) * alignment.rotation
        back = alignment._replace(rotation=conjugate)  # to where the cells are
        models = arrange_views(validation)[0][:_SHAPES, 0]
        threshold = surfaces.tune_threshold(
            [views[0] for views in cells[: len(models)]],
            [align_points(back, np.asarray(validation.surfaces[m])) for m in models],
        )
    return threshold


def find_surface(
    predictions: Predictions,
    row: int,
    threshold: float,
    alignment: Alignment,
    *,
    place: int = 0,
) -> tuple[np.ndarray, ...] | None:
    """Vertices [V, 3] and faces [F, 3] of a row's view; None where there is none.

    Args:
      place: of the view in its row.
      alignment: from the network's frame, in which the cells are, to the data's.
    """
    assert predictions.cells is not None
    cells = predictions.cells[row, place]
    vertices, faces = surfaces.extract_surface(cells, threshold)
    return (align_points(alignment, vertices), faces) if len(faces) else None
