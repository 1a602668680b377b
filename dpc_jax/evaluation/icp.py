"""Point-to-point ICP for one rotation shared by many pairs of point clouds."""

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation import rotations

_REACH = 0.2  # object units; points farther apart than this are no partners
_MAX_ITERATIONS = 30
_TOLERANCE_DEG = 0.01  # a smaller turn ends the search


# Search trees of a predicted cloud in the network's frame and of the true surface in
# that of the object. Only query points are turned, so each is built once.
CloudPair = tuple[KDTree, KDTree]


def best_rotation(source: np.ndarray, target: np.ndarray, weight=None) -> Rotation:
    """Rotation that brings source [n, 3] nearest to target [n, 3], n > 1 (Kabsch).

    Weighted least squares without translation: both frames share their origin. Where
    the points lie on one line, any turn about it is as good and one of them comes.
    """
    with warnings.catch_warnings():
        # scipy warns of points on a line, as a collapsed network predicts them.
        warnings.filterwarnings("ignore", "Optimal rotation is not uniquely")
        return Rotation.align_vectors(target, source, weights=weight)[0]


def shared_chamfer(pairs: Sequence[CloudPair], rotation: np.ndarray) -> float:
    """Mean Chamfer distance of the pairs once the predictions are turned."""
    matrix = rotations.to_rotation(rotation).as_matrix()
    total = 0.0
    for predicted, surface in pairs:
        precision, _ = surface.query(predicted.data @ matrix.T)
        coverage, _ = predicted.query(surface.data @ matrix)
        total += precision.mean() + coverage.mean()
    return float(total / len(pairs))


def _match(pairs: Sequence[CloudPair], rotation: np.ndarray) -> list[np.ndarray]:
    """Predicted points [n, 3], their nearest surface points [n, 3], and weights [n].

    From prediction to surface and back, within reach; each pair and each way weighs the
    same. With the predictions alone as queries a part could slide along the surface.
    """
    matrix = rotations.to_rotation(rotation).as_matrix()
    found = []
    for predicted, surface in pairs:
        near, index, weight = _find_partners(surface, predicted.data @ matrix.T)
        found.append((predicted.data[near], surface.data[index], weight))
        near, index, weight = _find_partners(predicted, surface.data @ matrix)
        found.append((predicted.data[index], surface.data[near], weight))
    return [np.concatenate(part) for part in zip(*found, strict=True)]


def _find_partners(tree, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points have a partner in the tree, its index, and the weight of each."""
    gap, index = tree.query(points, distance_upper_bound=_REACH)
    near = np.isfinite(gap)
    return near, index[near], np.full(near.sum(), 1.0 / near.size)


def fit_rotation(pairs: Sequence[CloudPair], start: np.ndarray) -> np.ndarray:
    """One rotation [4] for all pairs, at least one, by ICP from a start [4].

    It turns the network's frame to the object frame, and is the start itself where
    fewer than two points have a partner within reach, which determines no rotation.
    """
    rotation = rotations.normalize(start)
    for _ in range(_MAX_ITERATIONS):
        source, target, weight = _match(pairs, rotation)
        if len(weight) < 2:
            break
        best = best_rotation(source, target, weight)
        refined = rotations.to_quaternion(best)
        turn = rotations.angle_deg(refined, rotation)
        rotation = refined
        if turn < _TOLERANCE_DEG:
            break
    return rotation
