"""Predictions beside the training set: its nearest shapes and its mean shape."""

from typing import Any, NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.evaluation.chamfer import chamfer_distance
from dpc_jax.evaluation.training_shapes import ShapeIndex, find_mean_shape, spread_rows
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.reporting.examples import Neighbour, TrainingComparison

OBJECTS = 24  # test objects that are compared with the training set
# Of the mean shape: its Chamfer distance to test cars is within 3 % of that of all
# shapes and points, in a fifth of the time.
_SHAPES, _POINTS, _VALIDATED = 300, 2500, 5
_NEAREST, _MEAN = "Nearest training shape", "Mean training shape"
_OTHER = "The same of another object"


class TrainingShapes(NamedTuple):
    """True surfaces of a training set, to be searched, and their mean shape.

    Attributes:
      surfaces: [P, 3] points of each shape.
      index: of the same.
      mean: [N, 3].
    """

    surfaces: Any
    index: ShapeIndex
    mean: np.ndarray

    @classmethod
    def gather(cls, sets: dict[str, DataSet]) -> "TrainingShapes | None":
        """Those of a run's sets; None where a set has no true shapes.

        Args:
          sets: by name, "train", "val" and "test".
        """
        train, val, test = (sets[name].surfaces for name in ("train", "val", "test"))
        if train is None or val is None or test is None:
            return None
        mean = find_mean_shape(
            [spread_rows(train[i], _POINTS) for i in _spread(len(train), _SHAPES)],
            [spread_rows(val[i], _POINTS) for i in _spread(len(val), _VALIDATED)],
        )
        return cls(train, ShapeIndex(train), mean)

    def find_nearest(self, points: np.ndarray, count: int) -> np.ndarray:
        """The training shape nearest to points, as a cloud of `count` points.

        A Chamfer distance depends on the number of points: a prediction is compared
        fairly with as many.
        """
        return spread_rows(self.surfaces[self.index.find_nearest(points)], count)

    def list_neighbours(self, surface: np.ndarray, count: int) -> tuple[Neighbour, ...]:
        """What could be said of a true surface [P, 3] without predicting anything."""
        nearest = _NEAREST, self.find_nearest(surface, count)
        return tuple(
            Neighbour(title, cloud, 100 * chamfer_distance(cloud, surface).chamfer)
            for title, cloud in (nearest, (_MEAN, self.mean))
        )

    def compare(
        self, predictions: Predictions, dataset: DataSet, alignment: Alignment
    ) -> TrainingComparison:
        """Predictions from the first views of test objects against both baselines."""
        models, _ = arrange_views(dataset)
        rows = _spread(len(models), OBJECTS)
        surfaces = [np.asarray(dataset.surfaces[m]) for m in models[rows, 0]]
        clouds = [align_points(alignment, predictions.points[row, 0]) for row in rows]
        to_truth, to_prediction = {}, {}
        for i, (surface, cloud) in enumerate(zip(surfaces, clouds, strict=True)):
            count, other = len(cloud), (i + 1) % len(clouds)
            nearest = np.asarray(self.surfaces[self.index.find_nearest(cloud)])
            pairs: list[tuple] = [
                ("Prediction", to_truth, cloud, surface),
                (_NEAREST, to_truth, self.find_nearest(surface, count), surface),
                (_NEAREST, to_prediction, cloud, nearest),
                (_MEAN, to_truth, self.mean, surface),
                (_MEAN, to_prediction, cloud, self.mean),
            ]
            if other != i:
                both = [spread_rows(s, count) for s in (surface, surfaces[other])]
                pairs.append((_OTHER, to_truth, *both))
                pairs.append((_OTHER, to_prediction, cloud, clouds[other]))
            for name, distances, *pair in pairs:
                distance = 100 * chamfer_distance(*pair).chamfer
                distances.setdefault(name, []).append(distance)
        means = [
            {name: float(np.mean(values)) for name, values in found.items()}
            for found in (to_truth, to_prediction)
        ]
        return TrainingComparison(len(rows), *means)


def _spread(count: int, wanted: int) -> np.ndarray:
    """`wanted` indices spread over `count`; all of them where there are fewer."""
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).astype(int))
