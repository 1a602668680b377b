"""The worst tenth of the test objects, each by its worst view."""

import dataclasses
import math

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.pose import ACCURACY_THRESHOLD_DEG
from dpc_jax.evaluation.scores import Scores
from dpc_jax.learning.inference.evaluator import measure_overlaps
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.reporting.examples import Example
from dpc_jax.run.report.examples import make_example, rank_views

SHARE = 0.1  # of the objects
MOST = 20  # of a large test set


def choose_worst(badness: np.ndarray, models: np.ndarray) -> list[tuple[int, int]]:
    """The worst view (row, place) of each of the worst objects, worst object first.

    Args:
      badness: [n, V] of each view, higher is worse. An object is as bad as its views
        are in the mean.
      models: [n, V] the object of a view.
    """
    names = np.unique(models)
    means = np.array([badness[models == name].mean() for name in names])
    count = min(MOST, max(1, math.ceil(SHARE * len(names))))
    chosen = []
    for index in np.argsort(-means, kind="stable")[:count]:
        own = np.where(models == names[index], badness, -np.inf)
        row, place = np.unravel_index(np.argmax(own), own.shape)
        chosen.append((int(row), int(place)))
    return chosen


def list_worst(
    predictions: Predictions,
    dataset: DataSet,
    alignment: Alignment,
    result: Scores,
    *,
    distance: float,
) -> tuple[list[Example], str]:
    """The worst tenth of the objects, and a sentence on how they were chosen.

    Args:
      result: of the predictions. distance: of the camera.
    """
    models, _ = arrange_views(dataset)
    overlaps = measure_overlaps(predictions, dataset)
    badness, measure = rank_views(result, overlaps)
    examples = []
    for row, place in choose_worst(badness, models):
        example = make_example(
            predictions,
            dataset,
            alignment,
            result,
            ("", row, place),
            overlap=float(overlaps[row, place]),
            shapes=None,
            distance=distance,
            threshold=None,
        )
        own = models == models[row, place]
        note = _describe(result, own, example)
        examples.append(dataclasses.replace(example, name=f"{example.name}: {note}"))
    return examples, (
        f"The tenth of the test objects with the worst mean {measure} of their views"
        + (f" ({MOST} at most)" if len(examples) == MOST else "")
        + ", each by its worst view."
    )


def _describe(result: Scores, own: np.ndarray, example: Example) -> str:
    """What is wrong with an object, whose views are `own` [n, V]."""
    if result.pose_errors_deg is not None:
        errors = np.asarray(result.pose_errors_deg)[own]
        wrong = int(np.sum(errors > ACCURACY_THRESHOLD_DEG))
        parts = [f"{wrong} of {len(errors)} views wrong"]
    else:
        parts = [f"overlap {example.overlap:.2f}"]
    if example.chamfer is not None:
        parts.append(f"Chamfer {example.chamfer:.1f}")
    return ", ".join(parts)
