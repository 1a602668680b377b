"""Where a cloud is too thin: midpoints that fill it, and points that hang alone.

Neither is in the paper, whose clouds have 2000, 8000 and 16,000 points at 32, 64 and
128. A network of few points leaves holes in a surface that more points would fill, and
coverage pays for them (`chamfer`). Points nearby lie on the same surface, so that what
is halfway between two of them lies near it, too.

A point that no silhouette draws in, but each pushes out of the image, ends where the
pushes cancel. Then it hangs in the same place of every predicted shape: it is stray.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import check_points

DENSE_POINTS = 8000  # of a dense cloud: the paper's at 64
_NEAREST = 16  # of each point, to which there may be a midpoint
REACH = 0.1  # box diagonals, within which a point that is not stray has others
NEIGHBORS = 4  # so many


def densify(points: ArrayLike, count: int = DENSE_POINTS) -> np.ndarray:
    """The points [N, 3] and midpoints of neighbours behind them, [M, 3]; M ≤ count.

    The pairs are drawn among all of a point and one of its 16 nearest, always alike. A
    cloud of that many points or more is returned as it is; one of very few has
    fewer pairs than are asked for.

    Args:
      points: [N, 3]. count: of points, in all.

    Raises:
      ValueError: for no points, or one that is not finite.
    """
    points = check_points(points, name="points")
    pairs = find_pairs(points, count - len(points))
    return np.concatenate([points, mix_pairs(points, pairs)])


def find_pairs(points: np.ndarray, count: int) -> np.ndarray:
    """At most that many pairs [m, 2] of a point [N, 3] and a near one, each once."""
    reach = min(_NEAREST, len(points) - 1)
    if count <= 0 or reach == 0:
        return np.empty((0, 2), np.int64)
    _, near = KDTree(points).query(points, reach + 1)
    # Of points in one place any may be the first.
    first = np.repeat(np.arange(len(points)), reach + 1)
    pairs = np.sort(np.stack([first, near.reshape(-1)], axis=1), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    return np.random.default_rng(0).permutation(pairs)[:count]


def mix_pairs(values: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Means [m, ...] of the values [N, ...], places or colours, of each pair [m, 2]."""
    return (values[pairs[:, 0]] + values[pairs[:, 1]]) / 2


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
