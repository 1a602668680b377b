"""Confidence: agreement of the candidates, and overlap of the silhouettes."""

import numpy as np
import pytest

from dpc_jax.evaluation.confidence import describe, measure_confidence

POSE = np.array([1.0, 0, 0, 0])
HALF_TURN = np.array([0.0, 0, 0, 1])
NEAR = np.array([np.cos(np.radians(5)), 0, 0, np.sin(np.radians(5))])  # 10 degrees


def square(low, high):
    image = np.zeros((16, 16))
    image[low:high, low:high] = 1
    return image


def judge(candidates, probabilities, silhouette=square(4, 12), mask=square(4, 12)):
    return measure_confidence(
        POSE, np.stack(candidates), probabilities, silhouette, mask
    )


def test_candidates_that_agree_and_a_covered_mask_give_full_confidence():
    found = judge([POSE, NEAR], [0.5, 0.5])
    assert found.confidence == pytest.approx(1) and found.overlap == pytest.approx(1)
    assert found.level == "high" and found.rival_probability == 0
    # The root mean square of 0 and 10 degrees is 7.1.
    assert found.spread_deg == pytest.approx(np.sqrt(50))


def test_a_half_turn_that_is_as_likely_takes_the_trust_away():
    found = judge([POSE, HALF_TURN, NEAR], [0.3, 0.6, 0.1])
    assert found.agreement == pytest.approx(0.4) and found.level == "low"
    assert found.rival_probability == pytest.approx(0.6)
    assert "another pose has a chance of 60 %" in describe(found)


def test_a_silhouette_beside_the_mask_takes_the_trust_away():
    found = judge([POSE], [1.0], silhouette=square(0, 8), mask=square(8, 16))
    assert found.overlap == 0 and found.error == pytest.approx(0.5)
    assert found.level == "low" and "overlaps the mask by 0 %" in describe(found)
    empty = judge([POSE], [1.0], silhouette=np.zeros((16, 16)))
    assert empty.overlap == 0 and 0 < empty.confidence < 1
