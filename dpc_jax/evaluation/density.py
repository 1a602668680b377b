"""Where a cloud is too thin: midpoints that fill it, and points that hang alone.

Neither is in the paper. A network of few points leaves holes in a surface that more
points would fill; what is halfway between two neighbours lies near the surface, too. A
point that each silhouette pushes out of the image ends where the pushes cancel: there
it hangs in the same place of every predicted shape, stray.
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
    cloud of `count` points or more is returned as it is; one of very few has fewer
    pairs than are asked for. ValueError for no points, or one that is not finite.
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
