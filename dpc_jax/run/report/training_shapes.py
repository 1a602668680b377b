"""What Chamfer distances are compared with: a perfect cloud, and shapes of training.

A network no better than the training shape nearest to the truth may have learned to
copy; one whose predictions are all near the mean shape, to ignore its image
(Tatarchenko et al., What do single-view 3D reconstruction networks learn?, 2019).

The mean shape is where surfaces of training shapes are most often: the fullest cells of
a fine grid, each with the mean of the surface points in it. How many cells are taken is
tuned on validation shapes. It knows the true surfaces.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.evaluation.chamfer import Surface, chamfer_distance, spread_rows
from dpc_jax.evaluation.scores import ASKED
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.reporting.examples import Neighbour

_COARSE, _FINE = 64, 500  # points of a shape in the first and second comparison
# Training shapes that are compared a second time; of 24 the best is hardly nearer.
_SHORTLIST = 12
SIDE = 64  # cells of the unit cube along a side
COUNTS = (500, 1000, 2000, 4000, 8000, 16_000)  # of cells, to choose from
# Of the mean shape: its Chamfer distance to test cars is within 3 % of that of all
# shapes and points, in a fifth of the time.
_SHAPES, _POINTS, _VALIDATED = 300, 2500, 5
# Beside the predictions, and prefixes of their metrics.
REFERENCES = ("floor", "mean_shape", "nearest_shape", "own_mean")

Reader = Callable[[int], Any]  # gives the points [P, 3] of a shape


class TrainingShapes(NamedTuple):
    """True surfaces of a training set, to be searched, and their mean shape.

    Attributes:
      readers: by the prefix of the metrics: "" of whole surfaces and, where it is
        known, "visible_" of what is visible of them.
      means: [N, 3] the mean of each of these.
      coarse: of whole surfaces, see `coarsen`.
    """

    readers: dict[str, Reader]
    means: dict[str, np.ndarray]
    coarse: np.ndarray

    @classmethod
    def gather(cls, sets: dict[str, DataSet], most: int) -> "TrainingShapes | None":
        """Those of a run's sets; None where a set has no true shapes.

        Args:
          most: points of a mean shape, as many as a prediction has.
        """
        train, val, test = (_list_readers(sets[n]) for n in ("train", "val", "test"))
        shared = [prefix for prefix in train if prefix in val and prefix in test]
        if not shared:
            return None
        means = {p: _average(train[p], val[p], sets, most) for p in shared}
        coarse = coarsen(sets["train"].surfaces)
        return cls({p: train[p] for p in shared}, means, coarse)

    def find_nearest(self, points: np.ndarray, count: int) -> np.ndarray:
        """The training shape nearest to points, as a cloud of `count` points.

        A Chamfer distance depends on the number of points: a prediction is compared
        fairly with as many.
        """
        read = self.readers[""]
        return spread_rows(read(find_nearest(read, self.coarse, points)), count)

    def list_neighbours(self, surface: np.ndarray, count: int) -> tuple[Neighbour, ...]:
        """What could be said of a true surface [P, 3] without predicting anything."""
        nearest = "Nearest training shape", self.find_nearest(surface, count)
        return tuple(
            Neighbour(title, cloud, 100 * chamfer_distance(cloud, surface).chamfer)
            for title, cloud in (nearest, ("Mean training shape", self.means[""]))
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
        readers = _list_readers(dataset)
        for model in models.tolist():
            near = find_nearest(self.readers[""], self.coarse, readers[""](model))
            for prefix, mean in self.means.items():
                asked = ASKED if prefix else None
                truth = Surface(readers[prefix](model), asked=asked)
                nearest = self.readers[prefix](near)
                nearest = spread_rows(nearest, min(len(own), len(nearest)))
                floor = truth.measure_floor(len(clouds[0]))
                distances = floor, *map(truth.compare, (mean, nearest, own))
                for name, one in zip(REFERENCES, distances, strict=True):
                    found.setdefault(f"{prefix}{name}_chamfer", []).append(one.chamfer)
        return {name: 100 * float(np.mean(each)) for name, each in found.items()}


def _list_readers(data: DataSet) -> dict[str, Reader]:
    """As `TrainingShapes.readers`, of a set; none where its surfaces are not known."""
    if data.surfaces is None:
        return {}
    whole: dict[str, Reader] = {"": data.surfaces.__getitem__}
    return whole if data.visible is None else whole | {"visible_": data.read_visible}


def _average(read_train, read_val, sets, most) -> np.ndarray:
    """The cloud [N, 3] of the fullest cells, as many as suit the validation shapes.

    At most `most`: the more points, the smaller a Chamfer distance.
    """
    train, val = (len(sets[name].names) for name in ("train", "val"))
    shapes = [spread_rows(read_train(i), _POINTS) for i in _spread(train, _SHAPES)]
    shares, places = average_surfaces(shapes)
    counts = {min(count, most) for count in COUNTS}
    clouds = [take_fullest(shares, places, count) for count in sorted(counts)]
    judges = [spread_rows(read_val(i), _POINTS) for i in _spread(val, _VALIDATED)]
    truths = list(map(Surface, judges))

    def measure(cloud):
        return np.mean([truth.compare(cloud).chamfer for truth in truths])

    return min(clouds, key=measure)


def _spread(count: int, wanted: int) -> list[int]:
    """`wanted` indices spread over `count`; all of them where there are fewer."""
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).astype(int)).tolist()


def coarsen(surfaces: Sequence[Any]) -> np.ndarray:
    """A few points [n, 64, 3] of each of n surfaces [P, 3], at least one."""
    return np.stack([spread_rows(surface, _COARSE) for surface in surfaces])


def find_nearest(read: Reader, coarse: np.ndarray, points: np.ndarray) -> int:
    """Index of the surface of the smallest Chamfer distance to points.

    Args:
      read: of the surfaces. coarse: of the same, see `coarsen`.
      points: [N, 3], a predicted cloud or points of a true surface.
    """
    # By few points first.
    cloud = spread_rows(points, _COARSE)
    away = cdist(coarse.reshape(-1, 3), cloud).reshape(*coarse.shape[:2], len(cloud))
    rough = away.min(axis=1).mean(axis=-1) + away.min(axis=2).mean(axis=-1)
    shortlist = np.argsort(rough, kind="stable")[:_SHORTLIST].tolist()
    truth = Surface(spread_rows(points, _FINE))
    shapes = (spread_rows(read(index), _FINE) for index in shortlist)
    return shortlist[np.argmin([truth.compare(shape).chamfer for shape in shapes])]


def average_surfaces(
    surfaces: Sequence[Any], *, side: int = SIDE
) -> tuple[np.ndarray, np.ndarray]:
    """How many surfaces pass each cell of the unit cube, and where.

    Args:
      surfaces: [P, 3] points of each shape.

    Returns:
      ([side³] share of the shapes, [side³, 3] mean place of their points; where there
      is none, 0).
    """
    passed = np.zeros(side**3)
    counts, sums = np.zeros(side**3), np.zeros((side**3, 3))
    for surface in surfaces:
        points = np.asarray(surface, np.float64)
        cells = np.clip(np.floor((points + 0.5) * side), 0, side - 1).astype(int)
        flat = np.ravel_multi_index(tuple(cells.T), (side,) * 3)
        passed[np.unique(flat)] += 1
        counts += np.bincount(flat, minlength=side**3)
        for axis in range(3):
            weights = points[:, axis]
            sums[:, axis] += np.bincount(flat, weights, minlength=side**3)
    return passed / len(surfaces), sums / np.maximum(counts, 1)[:, None]


def take_fullest(shares: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
    """The places of the `count` cells that most surfaces pass; fewer if they are."""
    order = np.argsort(-shares, kind="stable")[:count]
    return places[order[shares[order] > 0]]
