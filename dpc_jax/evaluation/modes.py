"""The rotations that many views agree on, in spite of outliers and half turns."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation import rotations

INLIER_DEG = 30.0  # a vote this near agrees: the threshold of pose accuracy
_MAX_ITERATIONS, _TOLERANCE_DEG = 50, 1e-6  # of the robust mean
_KERNEL_DEG = 15.0  # width of the robust weight, half of the above (heuristic)


class Mode(NamedTuple):
    """A rotation [4] and the share of all votes within 30 degrees of it, 0 to 1."""

    rotation: np.ndarray
    share: float


def _robust_mean(votes: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Mean rotation [4] of votes [n, 4] around a start [4], outliers left aside.

    Iteratively re-weighted Markley mean with the Geman-McClure weight
    1 / (1 + (angle / kernel)^2)^2: a vote 180 degrees off weighs 5e-5. The start should
    be one of the votes or near some, as a median would be.
    """
    q = rotations.normalize(votes)
    mean = rotations.canonical_sign(start)
    for _ in range(_MAX_ITERATIONS):
        ratio = rotations.angle_deg(q, mean) / _KERNEL_DEG
        refined = rotations.mean_rotation(q, weights=(1.0 + ratio**2) ** -2)
        turn = rotations.angle_deg(refined, mean)
        mean = refined
        if turn < _TOLERANCE_DEG:
            break
    return mean


def find_modes(votes: ArrayLike, *, max_modes: int = 6) -> list[Mode]:
    """Modes of votes [n, 4], the one with the largest share first.

    The vote with the most neighbours starts a robust mean; its neighbourhood is taken
    away and the rest searched again. Networks without pose labels typically have two
    modes, half a turn apart.
    """
    q = rotations.normalize(votes).reshape(-1, 4)
    if len(q) == 0:
        raise ValueError(
            "votes must be at least one, but there are none; pass the poses of the "
            "validation views."
        )
    near = rotations.angle_deg(q[:, None], q[None]) <= INLIER_DEG
    left = np.ones(len(q), dtype=bool)
    modes: list[Mode] = []
    while left.any() and len(modes) < max_modes:
        density = np.where(left, near.sum(axis=1), -1)
        seed = int(np.argmax(density))
        mean = _robust_mean(q, q[seed])
        agree = rotations.angle_deg(q, mean) <= INLIER_DEG
        left &= ~(agree | near[seed])
        # A sparse seed can slide into a mode that is already known.
        if all(rotations.angle_deg(mean, m.rotation) > INLIER_DEG for m in modes):
            modes.append(Mode(mean, float(agree.mean())))
    return sorted(modes, key=lambda mode: -mode.share)
