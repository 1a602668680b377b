"""Scores: averages of rotations, angles in degrees, distances between clouds."""

import functools

import numpy as np

from dpc_jax.evaluation import (
    chamfer_distance,
    pose_summary,
    rotation_angle_deg,
    rotations,
)
from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import REAL, Case, make_cases

SUBJECT = "evaluation"
PLAIN = np.array([0.5, -1.0, 2.0, 0.25])
HALF = np.array([0.5, 0.5, -0.5, 0.5])
NEAR = np.array([1, 1e-7, 0, 0])
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
# name, quaternions, their mean
MEANS = (
    ("q and -q", [HALF, -HALF, HALF, -HALF], HALF),
    ("lengths 1e-30 and 1e30", [HALF * 1e-30, HALF * 1e30], HALF),
    ("1e-7 from each other", [NEAR, NEAR * [1, -1, 1, 1]], NEAR * [1, 0, 0, 0]),
    ("one alone", [PLAIN], PLAIN),
)
OPPOSITE = [[1, 0, 0, 0], [0, 0.6, 0, 0.8]]
AMBIGUOUS = "of two rotations half a turn apart every one between is a mean; one comes"
# Equal rotations have an angle of zero; the rounding of a product, in degrees, is left.
EQUAL = {"floor": 180.0}
ANGLES = (
    ("equal", PLAIN, PLAIN, EQUAL),
    ("q and -q", PLAIN, -PLAIN, EQUAL),
    ("half a turn", (1, 0, 0, 0), (0, 0, 1, 0)),
    ("1e-12 apart", (1, 1e-12, 0, 0), (1, 0, 0, 0)),
    ("lengths 1e-200 and 1e200", PLAIN * 1e-200, PLAIN[::-1] * 1e200),
)
CLOUDS = (
    ("plain", CLOUD, CLOUD[::-1] + 0.05),
    ("identical", CLOUD, CLOUD),
    ("coincident points", CLOUD * 0, CLOUD * 0),
    ("one point", CLOUD[:1], CLOUD),
    ("1e6 away", CLOUD + 1e6, CLOUD),
    ("1e-150 wide", CLOUD * 1e-150, CLOUD[:2] * 1e-150),
    ("1e150 wide", CLOUD * 1e150, CLOUD[:2] * 1e150),
)
# name, errors in degrees, (accuracy, median, share of flips)
SUMMARIES = (
    ("all right", [0.0, 0.0], (1, 0, 0)),
    ("exactly at the thresholds", [30.0, 150.0], (0.5, 90, 0)),
    ("exactly half a turn", [180.0], (0, 180, 1)),
)


def _average(quaternions):
    """Mean rotation, as q·qᵀ."""
    mean = rotations.mean_rotation(quaternions)
    return np.outer(mean, mean)


def _average_opposites(quaternions):
    """The mean's squared length, and its distance from the plane of the two."""
    mean = rotations.mean_rotation(quaternions)
    axes = np.linalg.qr(quaternions.T)[0]
    return np.array([mean @ mean, np.linalg.norm(mean - axes @ (axes.T @ mean))])


def _find_angle(p, q):
    return oracles.angle(p, q) * 180 / oracles.PI


def _measure(predicted, truth):
    return np.array(chamfer_distance(predicted, truth))


def _summarize(errors):
    return np.array(pose_summary(errors)[:3])


def _measure_exactly(predicted, truth):
    """Precision and coverage from all pairs, in long double."""
    away = predicted[:, None] - truth[None]
    distances = np.sqrt(np.sum(away * away, axis=-1))
    return np.array([np.mean(distances.min(axis=1)), np.mean(distances.min(axis=0))])


def list_cases() -> list[Case]:
    """The catalogue's cases on evaluation, which is numpy in float64."""
    make = functools.partial(
        make_cases,
        because="a few dozen roundings",
        is_traced=False,
    )

    def knows(*answer):  # a row's own oracle, which knows the answer
        return {"oracle": lambda *inputs: np.array(answer)}

    means = []
    for name, quaternions, mean in MEANS:
        unit = oracles.normalize(np.asarray(mean, REAL))
        means.append((name, quaternions, knows(*np.outer(unit, unit))))
    changes = {"function": _average_opposites, "limit": AMBIGUOUS}
    means.append(("half a turn apart", OPPOSITE, knows(1, 0) | changes))
    summaries = [(name, errors, knows(*found)) for name, errors, found in SUMMARIES]
    return [
        *make("average", _average, None, (64, None), means),
        *make("angle in degrees", rotation_angle_deg, _find_angle, (64, None), ANGLES),
        *make("chamfer", _measure, _measure_exactly, (64, None), CLOUDS),
        *make("pose summary", _summarize, None, (64, None), summaries),
    ]
