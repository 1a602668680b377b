"""Chamfer distance between point clouds, split into precision and coverage."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

_PAPER_UNITS = 100.0  # the paper's tables list distances times this, for diagonal 1


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


def chamfer_distance(
    predicted: ArrayLike,
    ground_truth: ArrayLike,
    *,
    tree: KDTree | None = None,
) -> Chamfer:
    """Eq. 6: Chamfer distance d_Chamf, of mean Euclidean (not squared) distances.

    Args:
      predicted: [N, 3] predicted points.
      ground_truth: [M, 3] points of the true surface, in the same frame and units.
      tree: the ground truth's own tree, where one shape is compared with many
        predictions; built here otherwise.

    Raises:
      ValueError: a cloud is empty, is not [., 3] or holds a non-finite coordinate, or
        the tree holds another number of points than `ground_truth`.
    """
    predicted = check_points(predicted, name="predicted")
    ground_truth = check_points(ground_truth, name="ground_truth")
    if tree is None:
        tree = KDTree(ground_truth)
    elif tree.n != len(ground_truth):
        raise ValueError(
            f"tree must hold the {len(ground_truth)} ground truth points, but is a "
            f"tree of {tree.n}; build it from the same array."
        )
    to_truth, _ = tree.query(predicted)
    to_prediction, _ = KDTree(predicted).query(ground_truth)
    return Chamfer(float(np.mean(to_truth)), float(np.mean(to_prediction)))


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
