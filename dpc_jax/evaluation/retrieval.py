"""The training shape that is nearest to a shape: what copying could reach.

All training shapes are compared by few points, those that come nearest by more. A
network whose predictions are no better than the training shape nearest to the truth
may have learned to copy; one whose predictions are all near the mean shape, to ignore
its image (§ "What do single-view 3D reconstruction networks learn?", Tatarchenko et
al., 2019, which retrieves in the same way).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

_COARSE, _FINE = 64, 500  # points of a shape in the first and second comparison
_SHORTLIST = 24  # training shapes that are compared a second time


class ShapeIndex:
    """Training shapes, to be searched.

    Args:
      surfaces: [P, 3] points of each shape, at least one shape; all in one frame.
    """

    def __init__(self, surfaces: Sequence[Any]):
        self._surfaces = surfaces
        coarse = [spread_rows(surface, _COARSE) for surface in surfaces]
        self._coarse = np.stack(coarse).astype(np.float32)
        self._fine: dict[int, tuple[np.ndarray, KDTree]] = {}

    def find_nearest(self, points: np.ndarray) -> int:
        """Index of the training shape of the smallest Chamfer distance to points.

        Args:
          points: [N, 3], a predicted cloud or points of a true surface.
        """
        rough = self._compare_roughly(spread_rows(points, _COARSE).astype(np.float32))
        shortlist = np.argsort(rough, kind="stable")[:_SHORTLIST]
        cloud = spread_rows(points, _FINE)
        tree = KDTree(cloud)
        distances = []
        for index in shortlist.tolist():
            surface, its_tree = self._read_fine(index)
            there, back = tree.query(surface)[0], its_tree.query(cloud)[0]
            distances.append(there.mean() + back.mean())
        return int(shortlist[np.argmin(distances)])

    def _compare_roughly(self, cloud):
        """Chamfer distances [T] by few points: all pairs, in one matrix product."""
        count, size, _ = self._coarse.shape
        shapes = self._coarse.reshape(-1, 3)
        square = (shapes**2).sum(-1)[:, None] - 2 * (shapes @ cloud.T)
        square = (square + (cloud**2).sum(-1)).reshape(count, size, len(cloud))
        nearest = square.min(axis=1), square.min(axis=2)
        return sum(np.sqrt(np.maximum(n, 0)).mean(-1) for n in nearest)

    def _read_fine(self, index):
        if index not in self._fine:
            surface = spread_rows(self._surfaces[index], _FINE)
            self._fine[index] = surface, KDTree(surface)
        return self._fine[index]


def spread_rows(points: Any, count: int) -> np.ndarray:
    """`count` of the points [N, 3], evenly spread over their order; repeated if fewer.

    Points of a surface are drawn at random, so any of them are a fair sample.
    """
    rows = np.linspace(0, len(points) - 1, count).round().astype(int)
    return np.asarray(points[rows], np.float64)
