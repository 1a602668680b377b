"""Distances between point clouds and within one: Chamfer distance, stray points."""

import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

_PAPER_UNITS = 100.0  # the paper's tables list distances times this, for diagonal 1
_REACH = 0.1  # box diagonals, within which a point that is not stray has others
_NEIGHBORS = 4  # so many
# SciPy's own trees of 100,000 points take twice as long to build, and a query half as
# long again.
_TREE: dict[str, Any] = dict(leafsize=32, balanced_tree=False, compact_nodes=False)


class Chamfer(NamedTuple):
    """Mean nearest-neighbour distances, in the units of the points (not times 100)."""

    precision: float  # from a predicted point to the ground truth
    coverage: float  # from a ground truth point to the prediction

    @property
    def chamfer(self) -> float:
        """Precision plus coverage: the paper's d_Chamf."""
        return self.precision + self.coverage

    def in_paper_units(self) -> dict[str, float]:
        """`chamfer`, `precision` and `coverage` times 100, as in the tables."""
        distances = {"chamfer": self.chamfer} | self._asdict()
        return {name: _PAPER_UNITS * value for name, value in distances.items()}


class Surface:
    """Points of a true surface, ready to be compared with many clouds.

    Args:
      points: [P, 3].
      asked: how many of them, evenly spread over their order, are asked for their
        distance to a cloud; all if None. The others make the distance of a cloud to
        them one to the surface.
      name: for the error.

    Raises:
      ValueError: as `chamfer_distance`.
    """

    def __init__(self, points: ArrayLike, *, asked: int | None = None, name="surface"):
        self.points = check_points(points, name=name)
        count = len(self.points)
        self._asked = spread_rows(self.points, min(asked or count, count))
        self._tree = KDTree(self.points, **_TREE)

    def compare(self, predicted: ArrayLike) -> Chamfer:
        """Distances of a cloud [N, 3] from this surface."""
        predicted = check_points(predicted, name="predicted")
        threads = len(os.sched_getaffinity(0))  # SciPy's -1 are all of the machine
        to_truth, _ = self._tree.query(predicted, workers=threads)
        to_prediction, _ = KDTree(predicted).query(self._asked, workers=threads)
        return Chamfer(float(np.mean(to_truth)), float(np.mean(to_prediction)))

    def measure_floor(self, count: int) -> Chamfer:
        """Distances of `count` of its own points, at most half, from the others."""
        rows = find_rows(len(self.points), min(count, len(self.points) // 2))
        to_truth = self._tree.query(self.points[rows], k=2)[0][:, 1]  # not themselves
        others = np.delete(self.points, rows, axis=0)
        asked = spread_rows(others, min(len(self._asked), len(others)))
        to_prediction, _ = KDTree(self.points[rows]).query(asked)
        return Chamfer(float(np.mean(to_truth)), float(np.mean(to_prediction)))


def chamfer_distance(predicted: ArrayLike, ground_truth: ArrayLike) -> Chamfer:
    """Eq. 6: Chamfer distance d_Chamf, of mean Euclidean (not squared) distances.

    Args:
      predicted: [N, 3] predicted points.
      ground_truth: [M, 3] points of the true surface, in the same frame and units.

    Returns:
      `Chamfer`: precision and coverage, and `chamfer`, their sum, in the points' units.

    Raises:
      ValueError: a cloud is empty, is not [., 3] or holds a non-finite coordinate.

    Example:
      >>> dpc_jax.chamfer_distance([[0, 0, 0]], [[0, 0, 0], [0, 3, 4]]).chamfer
      2.5
    """
    return Surface(ground_truth, name="ground_truth").compare(predicted)


def count_stray_points(points: ArrayLike) -> int:
    """How many of points [N, 3] have fewer than four others within a tenth of the box.

    Not in the paper. A point that each silhouette pushes out of the image ends where
    the pushes cancel: there it hangs alone, in the same place of every shape. Clouds of
    fewer points have no others. The unit is the diagonal of the object's box.
    ValueError for points that are not finite, or of another shape.
    """
    cloud = check_points(points, name="points")
    wanted = min(_NEIGHBORS, len(cloud) - 1)
    if wanted < 1:
        return 0
    distances, _ = KDTree(cloud).query(cloud, k=wanted + 1)  # the first is itself
    return int(np.sum(distances[:, -1] > _REACH))


def find_rows(total: int, count: int) -> np.ndarray:
    """`count` of the indices below `total`, evenly spread; repeated if fewer."""
    return np.linspace(0, total - 1, count).round().astype(int)


def spread_rows(points: Any, count: int) -> np.ndarray:
    """`count` of the points [N, 3], evenly spread over their order; repeated if fewer.

    Points of a surface are drawn at random, so any of them are a fair sample.
    """
    return np.asarray(points[find_rows(len(points), count)], np.float64)


def check_points(points: ArrayLike, *, name: str) -> np.ndarray:
    """The points [N, 3] in float64; ValueError for none, or one that is not finite."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise ValueError(
            f"Expected {name} to be a point cloud [N, 3] with at least one point, but "
            f"its shape is {array.shape}; pass one cloud per call."
        )
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        raise ValueError(
            f"Expected finite coordinates in {name}, but {int((~finite).sum())} of "
            f"{len(array)} points have NaN or infinity; find where they arise: the "
            f"network may have diverged."
        )
    return array
