"""What Chamfer distances are compared with: a perfect cloud, and shapes of training."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.evaluation.chamfer import Surface, chamfer_distance, spread_rows
from dpc_jax.evaluation.scores import ASKED
from dpc_jax.evaluation.training_shapes import (
    ShapeIndex,
    average_surfaces,
    find_mean_shape,
    take_fullest,
)
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.reporting.examples import Neighbour

# Of the mean shape: its Chamfer distance to test cars is within 3 % of that of all
# shapes and points, in a fifth of the time.
_SHAPES, _POINTS, _VALIDATED = 300, 2500, 5
# Beside the predictions, and prefixes of their metrics.
REFERENCES = ("floor", "mean_shape", "nearest_shape", "own_mean")


class TrainingShapes(NamedTuple):
    """True surfaces of a training set, to be searched, and their mean shape."""

    surfaces: Any  # [P, 3] points of each shape
    index: ShapeIndex  # of the same
    mean: np.ndarray  # [N, 3]
    # Gives what is visible of each shape; None where it is not known.
    read_visible: Callable[[int], np.ndarray] | None = None
    visible_mean: np.ndarray | None = None  # [N, 3], the mean of that

    @classmethod
    def gather(cls, sets: dict[str, DataSet], most: int) -> "TrainingShapes | None":
        """Those of a run's sets; None where a set has no true shapes.

        Args:
          most: points of a mean shape, as many as a prediction has.
        """
        train, val, test = (sets[name] for name in ("train", "val", "test"))
        if train.surfaces is None or val.surfaces is None or test.surfaces is None:
            return None
        reads = train.surfaces.__getitem__, val.surfaces.__getitem__
        mean = _average(*reads, sets, most)
        index = ShapeIndex(train.surfaces)
        if any(data.visible is None for data in (train, val, test)):
            return cls(train.surfaces, index, mean)
        visible_mean = _average(train.read_visible, val.read_visible, sets, most)
        return cls(train.surfaces, index, mean, train.read_visible, visible_mean)

    def find_nearest(self, points: np.ndarray, count: int) -> np.ndarray:
        """The training shape nearest to points, as a cloud of `count` points.

        A Chamfer distance depends on the number of points: a prediction is compared
        fairly with as many.
        """
        return spread_rows(self.surfaces[self.index.find_nearest(points)], count)

    def list_neighbours(self, surface: np.ndarray, count: int) -> tuple[Neighbour, ...]:
        """What could be said of a true surface [P, 3] without predicting anything."""
        nearest = "Nearest training shape", self.find_nearest(surface, count)
        return tuple(
            Neighbour(title, cloud, 100 * chamfer_distance(cloud, surface).chamfer)
            for title, cloud in (nearest, ("Mean training shape", self.mean))
        )

    def measure_references(
        self, predictions: Predictions, dataset: DataSet, alignment: Alignment
    ) -> dict[str, float]:
        """Chamfer distances (times 100) of `REFERENCES`, means over the objects.

        The floor is that of as many true points as a prediction has from the other
        ones; the nearest training shape is found by the truth; the network's own mean
        is that of its predictions. With the prefix `visible_` all are distances from
        what can be seen, of what can be seen of training shapes.
        """
        models, rows = np.unique(arrange_views(dataset)[0][:, 0], return_index=True)
        clouds = [align_points(alignment, predictions.points[r, 0]) for r in rows]
        own = take_fullest(*average_surfaces(clouds), len(clouds[0]))
        found: dict[str, list[float]] = {}
        for model in models.tolist():
            surface = np.asarray(dataset.surfaces[model])
            near = self.index.find_nearest(surface)
            truths: dict[str, tuple[Surface, Any, Any]] = {
                "": (Surface(surface), self.mean, self.surfaces[near])
            }
            if self.read_visible is not None:
                visible = Surface(dataset.read_visible(model), asked=ASKED)
                shapes = self.visible_mean, self.read_visible(near)
                truths["visible_"] = visible, *shapes
            for prefix, (truth, mean, nearest) in truths.items():
                nearest = spread_rows(nearest, min(len(own), len(nearest)))
                floor = truth.measure_floor(len(clouds[0]))
                distances = floor, *map(truth.compare, (mean, nearest, own))
                for name, one in zip(REFERENCES, distances, strict=True):
                    found.setdefault(f"{prefix}{name}_chamfer", []).append(one.chamfer)
        return {name: 100 * float(np.mean(each)) for name, each in found.items()}


def _average(read_train, read_val, sets, most) -> np.ndarray:
    train, val = (len(sets[name].names) for name in ("train", "val"))
    return find_mean_shape(
        [spread_rows(read_train(i), _POINTS) for i in _spread(train, _SHAPES)],
        [spread_rows(read_val(i), _POINTS) for i in _spread(val, _VALIDATED)],
        most=most,
    )


def _spread(count: int, wanted: int) -> list[int]:
    """`wanted` indices spread over `count`; all of them where there are fewer."""
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).astype(int)).tolist()
