"""The points that voxel models are judged by; loaded for these alone."""

from collections.abc import Callable

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.learning.inference import volumes
from dpc_jax.learning.inference.predictor import Predictions


def find_points(
    predictions: dict[str, Predictions],
    validation: DataSet,
    *,
    align: Callable[[Predictions], Alignment],
) -> tuple[dict[str, Predictions], float]:
    """Predictions with points of their surfaces, and the threshold, tuned first.

    Args:
      predictions: by split, "val" among them.
      validation: that split. Without true shapes the threshold stays the first one.
      align: of validation predictions with points.
    """
    threshold = volumes.FIRST_THRESHOLD
    if validation.surfaces is not None:
        first = volumes.add_points(predictions["val"], threshold, count=2000)
        threshold = volumes.choose_threshold(first, validation, align(first))
    found = {
        name: volumes.add_points(each, threshold) for name, each in predictions.items()
    }
    return found, threshold
