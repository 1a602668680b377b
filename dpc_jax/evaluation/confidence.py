"""How far a prediction can be trusted without knowing the truth.

Two signs: whether the ensemble's candidates agree on the pose, weighed by the student's
probabilities, and how well the predicted silhouette covers the given one.
docs/predict.md says what they are worth.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation import images
from dpc_jax.evaluation.rotations import normalize, rotation_angle_deg

AGREEING_DEG = 30.0  # from the pose: the threshold of pose accuracy
_TYPICAL_ERROR = 0.1  # squared difference per pixel that costs 1 - 1/e of confidence
LEVELS = (("high", 0.7), ("fair", 0.5), ("low", 0.0))  # from which confidence


class Confidence(NamedTuple):
    """What is known of one view's prediction."""

    confidence: float  # 0 to 1, agreement times the share for the silhouette
    agreement: float  # probability of the candidates within 30 degrees of the pose
    # How far all candidates are from the pose: root mean square by probability.
    spread_deg: float
    overlap: float  # intersection over union of the soft silhouettes
    error: float  # squared difference of the silhouettes per pixel
    # Of all candidates near the likeliest one beyond 30 degrees.
    rival_probability: float

    @property
    def level(self) -> str:
        """The first of `LEVELS` that the confidence reaches."""
        return next(name for name, least in LEVELS if self.confidence >= least)


def measure_confidence(
    pose: ArrayLike,
    candidates: ArrayLike,
    probabilities: ArrayLike,
    silhouette: ArrayLike,
    mask: ArrayLike,
) -> Confidence:
    """The confidence in one view's prediction.

    Args:
      pose: [4] that was predicted. candidates: [C, 4]. probabilities: [C], sum 1.
      silhouette: [D, D] seen from that pose. mask: [D, D], both 0 to 1.
    """
    found = normalize(candidates)
    weights = np.asarray(probabilities, np.float64)
    angles = rotation_angle_deg(found, pose)
    is_near = angles <= AGREEING_DEG
    agreement, chance = float(weights[is_near].sum()), 0.0
    if (~is_near).any():
        rival = found[np.argmax(np.where(is_near, -1.0, weights))]
        is_like = ~is_near & (rotation_angle_deg(found, rival) <= AGREEING_DEG)
        chance = float(weights[is_like].sum())
    seen, given = np.asarray(silhouette, np.float64), np.asarray(mask, np.float64)
    error = float(np.mean((seen - given) ** 2))
    return Confidence(
        confidence=agreement * float(np.exp(-error / _TYPICAL_ERROR)),
        agreement=agreement,
        spread_deg=float(np.sqrt(np.sum(weights * angles**2))),
        overlap=images.measure_overlap(seen, given),
        error=error,
        rival_probability=chance,
    )


def describe(found: Confidence) -> str:
    """A plain sentence on a prediction."""
    covered = f"its silhouette overlaps the mask by {100 * found.overlap:.0f} %"
    if found.level == "high":
        return f"Trust is high: the candidates agree on the pose, and {covered}."
    doubts = []
    if found.agreement < LEVELS[0][1]:
        share = 100 * found.rival_probability
        doubts.append(f"another pose has a chance of {share:.0f} %")
    if np.exp(-found.error / _TYPICAL_ERROR) < LEVELS[0][1] or not doubts:
        doubts.append(f"{covered}, less than usual for a good prediction")
    return f"Trust is {found.level}: {' and '.join(doubts)}."
