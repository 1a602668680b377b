"""Stray points: predicted points that hang alone, away from the rest of their cloud.

A point that no silhouette draws in, but each pushes out of the image, ends where the
pushes cancel. Then it hangs in the same place of every predicted shape.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import check_points

REACH = 0.1  # box diagonals
NEIGHBORS = 4


def count_stray_points(
    points: ArrayLike, *, reach: float = REACH, neighbors: int = NEIGHBORS
) -> int:
    """How many of points [N, 3] have fewer than some neighbours within their reach.

    Args:
      points: in units in which the object's box has a diagonal of 1.
      reach: in that unit.
      neighbors: that a point of a surface has; clouds of fewer points have no others.

    Raises:
      ValueError: for points that are not finite, or of another shape.
    """
    cloud = check_points(points, name="points")
    wanted = min(neighbors, len(cloud) - 1)
    if wanted < 1:
        return 0
    distances, _ = KDTree(cloud).query(cloud, k=wanted + 1)  # the first is itself
    return int(np.sum(distances[:, -1] > reach))
