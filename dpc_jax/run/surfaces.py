"""The points that voxel models are judged by; loaded for these alone."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.evaluation.surfaces import extract_surface
from dpc_jax.files import describe_error, read_json
from dpc_jax.learning.inference import volumes
from dpc_jax.learning.inference.predictor import Predictions


def find_points(
    predictions: Predictions,
    validation: DataSet,
    *,
    align: Callable[[Predictions], Alignment],
) -> tuple[Predictions, float]:
    """Predictions with points of their surfaces, and the threshold, tuned first.

    Args:
      predictions: for the validation split.
      validation: that split. Without true shapes the threshold stays the first one.
      align: of predictions with points.
    """
    threshold = volumes.FIRST_THRESHOLD
    if validation.surfaces is not None:
        first = volumes.add_points(predictions, threshold, count=2000)
        threshold = volumes.choose_threshold(first, validation, align(first))
    return volumes.add_points(predictions, threshold), threshold


def read_threshold(workdir: Path) -> float:
    """The threshold that a finished run has tuned.

    Before a run is finished, the one that tuning begins with.

    Raises:
      ValueError: where the run's metrics cannot be read.
    """
    path = workdir / "report" / "metrics.json"
    threshold = volumes.FIRST_THRESHOLD
    if path.exists():
        try:
            metrics = read_json(path)
            threshold = float(metrics["surface_threshold"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"Expected the threshold of surfaces in {path}, but it cannot be "
                f"read ({describe_error(error)}); start the command that began the "
                "run again."
            ) from None
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
    vertices, faces = extract_surface(predictions.cells[row, place], threshold)
    if not len(faces):
        return None
    return align_points(alignment, vertices), faces
