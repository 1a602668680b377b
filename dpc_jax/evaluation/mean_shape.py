"""The training set's mean shape as a prediction: what comes of seeing no image.

Where surfaces of training shapes are most often: the fullest cells of a fine grid, each
with the mean of the surface points in it. How many cells are taken is tuned on
validation shapes. It is told the true surfaces of the training set, the parts inside of
objects too, which models that learn from views never see.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import Chamfer, chamfer_distance

SIDE = 64  # cells of the unit cube along a side
COUNTS = (500, 1000, 2000, 4000, 8000, 16_000)  # of cells, to choose from


def find_mean_shape(train: Sequence[Any], val: Sequence[Any]) -> np.ndarray:
    """The cloud [N, 3] of the fullest cells, as many as suit the validation shapes.

    Args:
      train, val: [P, 3] points of the surface of each shape.
    """
    shares, places = average_surfaces(train)
    clouds = [take_fullest(shares, places, count) for count in COUNTS]
    return min(clouds, key=lambda cloud: average_distance(cloud, val).chamfer)


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


def average_distance(cloud: np.ndarray, surfaces: Sequence[Any]) -> Chamfer:
    """Mean distances of one cloud [N, 3] from the surfaces [P, 3] of many shapes."""
    found = [
        chamfer_distance(cloud, surface, tree=KDTree(surface)) for surface in surfaces
    ]
    return Chamfer(*np.mean(found, axis=0).tolist())
