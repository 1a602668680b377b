"""Stray points: those of a cloud that hang alone.

Not in the paper. A point that each silhouette pushes out of the image ends where the
pushes cancel: there it hangs in the same place of every predicted shape.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import check_points

REACH = 0.1  # box diagonals, within which a point that is not stray has others
NEIGHBORS = 4  # so many


def count_stray_points(points: ArrayLike) -> int:
    """How many of points [N, 3] have fewer than four others within a tenth of the box.

    Clouds of fewer points have no others. The unit is the diagonal of the object's box.
    ValueError for points that are not finite, or of another shape.
    """
    cloud = check_points(points, name="points")
    wanted = min(NEIGHBORS, len(cloud) - 1)
    if wanted < 1:
        return 0
    distances, _ = KDTree(cloud).query(cloud, k=wanted + 1)  # the first is itself
    return int(np.sum(distances[:, -1] > REACH))
