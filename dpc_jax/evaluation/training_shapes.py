"""What the training set alone could predict: its nearest shape and its mean shape.

A network no better than the training shape nearest to the truth may have learned to
copy; one whose predictions are all near the mean shape, to ignore its image
(Tatarchenko et al., What do single-view 3D reconstruction networks learn?, 2019).

The mean shape is where surfaces of training shapes are most often: the fullest cells of
a fine grid, each with the mean of the surface points in it. How many cells are taken is
tuned on validation shapes. It knows the true surfaces.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from dpc_jax.evaluation.chamfer import Surface, spread_rows

_COARSE, _FINE = 64, 500  # points of a shape in the first and second comparison
_SHORTLIST = 24  # training shapes that are compared a second time
SIDE = 64  # cells of the unit cube along a side
COUNTS = (500, 1000, 2000, 4000, 8000, 16_000)  # of cells, to choose from


class ShapeIndex:
    """Training shapes, to be searched.

    Args:
      surfaces: [P, 3] points of each shape, at least one shape; all in one frame.
    """

    def __init__(self, surfaces: Sequence[Any]):
        self._surfaces = surfaces
        self._coarse = np.stack([spread_rows(s, _COARSE) for s in surfaces])

    def find_nearest(self, points: np.ndarray) -> int:
        """Index of the training shape of the smallest Chamfer distance to points.

        Args:
          points: [N, 3], a predicted cloud or points of a true surface.
        """
        # By few points first.
        cloud = spread_rows(points, _COARSE)
        away = cdist(self._coarse.reshape(-1, 3), cloud)
        away = away.reshape(*self._coarse.shape[:2], len(cloud))
        rough = away.min(axis=1).mean(axis=-1) + away.min(axis=2).mean(axis=-1)
        shortlist = np.argsort(rough, kind="stable")[:_SHORTLIST].tolist()
        truth = Surface(spread_rows(points, _FINE))
        shapes = (spread_rows(self._surfaces[index], _FINE) for index in shortlist)
        return shortlist[np.argmin([truth.compare(shape).chamfer for shape in shapes])]


def find_mean_shape(
    train: Sequence[Any], val: Sequence[Any], *, most: int
) -> np.ndarray:
    """The cloud [N, 3] of the fullest cells, as many as suit the validation shapes.

    Args:
      train, val: [P, 3] points of the surface of each shape.
      most: that N may be. The more points, the smaller a Chamfer distance.
    """
    shares, places = average_surfaces(train)
    counts = {min(count, most) for count in COUNTS}
    clouds = [take_fullest(shares, places, count) for count in sorted(counts)]
    truths = [Surface(points) for points in val]

    def measure(cloud):
        return np.mean([truth.compare(cloud).chamfer for truth in truths])

    return min(clouds, key=measure)


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
