"""Which members of the pose ensemble win, and whether it has collapsed."""

import numpy as np
from numpy.typing import ArrayLike

ALIVE_THRESHOLD = 0.01
DOMINANT_SHARE = 0.95  # heuristic: beyond it the ensemble works like one regressor


def winner_share(winners: ArrayLike, *, num_candidates: int) -> np.ndarray:
    """Share [K] of views that each candidate wins, from the winners' indices.

    Raises:
      ValueError: there are no winners, they are not integers, or one is outside 0..K-1.
    """
    indices = np.asarray(winners).ravel()
    if indices.size == 0 or not np.issubdtype(indices.dtype, np.integer):
        raise ValueError(
            f"winners must be at least one integer index, but are {indices.size} of "
            f"type {indices.dtype}; pass the argmin of the losses."
        )
    if indices.min() < 0 or indices.max() >= num_candidates:
        raise ValueError(
            f"winners must be between 0 and {num_candidates - 1}, but are "
            f"{indices.min()} to {indices.max()}; pass num_candidates as large as the "
            f"ensemble, including turned copies."
        )
    return np.bincount(indices, minlength=num_candidates) / indices.size


def count_alive(shares: ArrayLike, *, threshold: float = ALIVE_THRESHOLD) -> int:
    """How many candidates win at least a share of `threshold` of the views."""
    return int(np.sum(np.asarray(shares, np.float64) >= threshold))


def collapse_warning(shares: ArrayLike) -> str | None:
    """A sentence if the ensemble has collapsed onto one candidate, else None.

    An ensemble of one (K = 1) has nothing to collapse.
    """
    p = np.asarray(shares, np.float64)
    if p.size <= 1:
        return None
    alive, leader = count_alive(p), int(np.argmax(p))
    if alive >= 2 and p[leader] <= DOMINANT_SHARE:
        return None
    return (
        f"The pose ensemble has collapsed: candidate {leader} wins "
        f"{100 * p[leader]:.1f} % of the views and {alive} of {p.size} win at least "
        f"{100 * ALIVE_THRESHOLD:g} %; it learns poses no better than a single "
        f"regressor. More heads, initial quaternions that are farther apart, or "
        f"another seed usually help."
    )
