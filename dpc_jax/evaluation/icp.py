"""Point-to-point ICP for one rotation shared by many pairs of point clouds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from dpc_jax.evaluation import rotations

REACH = 0.2  # object units; points farther apart than this are no partners


class CloudPair(NamedTuple):
    """A predicted cloud and the true surface, with their search trees."""

    predicted: np.ndarray  # [N, 3] network's frame
    surface: np.ndarray  # [P, 3] object frame
    predicted_tree: cKDTree
    surface_tree: cKDTree


class Matches(NamedTuple):
    """Partners found under some rotation, from all pairs and both ways."""

    source: np.ndarray  # [n, 3] predicted points, network's frame
    target: np.ndarray  # [n, 3] their partners on the surfaces, object frame
    weight: np.ndarray  # [n] so that each pair and each way counts the same


def pair_clouds(predicted: np.ndarray, surface: np.ndarray) -> CloudPair:
    """A pair with both its trees.

    Only the query points are turned during the search, so each tree is built once.
    """
    return CloudPair(predicted, surface, cKDTree(predicted), cKDTree(surface))


def best_rotation(
    source: np.ndarray, target: np.ndarray, *, weight: np.ndarray | None = None
) -> np.ndarray:
    """Rotation matrix [3, 3] that brings source [n, 3] nearest to target [n, 3].

    Weighted least squares without translation (Kabsch): both frames share their origin,
    the centre of the box. A reflection is never returned.
    """
    weighted = source if weight is None else source * weight[:, None]
    u, _, vt = np.linalg.svd(target.T @ weighted)
    handedness = 1.0 if np.linalg.det(u @ vt) > 0.0 else -1.0
    return u @ np.diag([1.0, 1.0, handedness]) @ vt


def shared_chamfer(pairs: Sequence[CloudPair], rotation: np.ndarray) -> float:
    """Mean Chamfer distance of the pairs once the predictions are turned."""
    matrix = rotations.rotation_matrix(rotation)
    total = 0.0
    for pair in pairs:
        precision, _ = pair.surface_tree.query(pair.predicted @ matrix.T)
        coverage, _ = pair.predicted_tree.query(pair.surface @ matrix)
        total += precision.mean() + coverage.mean()
    return float(total / len(pairs))


def match(
    pairs: Sequence[CloudPair], rotation: np.ndarray, *, reach: float = REACH
) -> Matches:
    """Nearest neighbours within reach, from prediction to surface and back.

    Both ways, as in the Chamfer distance: with the predictions alone as queries a cloud
    that covers only a part of the surface could slide along it.
    """
    matrix = rotations.rotation_matrix(rotation)
    found = []
    for pair in pairs:
        gap, index = pair.surface_tree.query(
            pair.predicted @ matrix.T, distance_upper_bound=reach
        )
        near = np.isfinite(gap)
        weight = np.full(near.sum(), 1.0 / near.size)
        found.append((pair.predicted[near], pair.surface[index[near]], weight))
        gap, index = pair.predicted_tree.query(
            pair.surface @ matrix, distance_upper_bound=reach
        )
        near = np.isfinite(gap)
        weight = np.full(near.sum(), 1.0 / near.size)
        found.append((pair.predicted[index[near]], pair.surface[near], weight))
    return Matches(*(np.concatenate(part) for part in zip(*found, strict=True)))


def match_rms(matches: Matches, rotation: np.ndarray) -> float:
    """Root mean square distance of the matches; infinite where there are none.

    Zero without any match would rank an alignment that touches nothing best.
    """
    if len(matches.weight) == 0:
        return float("inf")
    gaps = matches.source @ rotations.rotation_matrix(rotation).T - matches.target
    return float(np.sqrt(np.average(np.sum(gaps**2, axis=1), weights=matches.weight)))


def fit_rotation(
    pairs: Sequence[CloudPair],
    start: np.ndarray,
    *,
    reach: float = REACH,
    max_iterations: int = 30,
    tolerance_deg: float = 0.01,
) -> np.ndarray:
    """One rotation [4] for all pairs, by ICP from a start [4].

    Args:
      pairs: at least one.
      start: quaternion, network's frame to object frame.
      reach: partners farther apart than this (object units) are not matched.
      max_iterations: matchings and fits at most.
      tolerance_deg: a turn smaller than this ends the search.

    Returns:
      The rotation; the start itself where no point is within reach of another.
    """
    rotation = rotations.normalize(start)
    for _ in range(max_iterations):
        matches = match(pairs, rotation, reach=reach)
        if len(matches.weight) == 0:
            break
        matrix = best_rotation(matches.source, matches.target, weight=matches.weight)
        refined = rotations.from_matrix(matrix)
        turn = rotations.angle_deg(refined, rotation)
        rotation = refined
        if turn < tolerance_deg:
            break
    return rotation
