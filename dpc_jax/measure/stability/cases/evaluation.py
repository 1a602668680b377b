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
from dpc_jax.measure.stability.cases.case import REAL, Case

SUBJECT = "evaluation"
PLAIN = np.array([0.5, -1.0, 2.0, 0.25])
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
AMBIGUOUS = "of two rotations half a turn apart every one between is a mean; one comes"


def average(quaternions):
    """Mean rotation, as q·qᵀ."""
    mean = rotations.mean_rotation(quaternions)
    return np.outer(mean, mean)


def average_opposites(quaternions):
    """The mean's length, and how far it is off the two that it averages."""
    mean = rotations.mean_rotation(quaternions)
    axes = np.linalg.qr(quaternions.T)[0]
    return np.array([mean @ mean, np.linalg.norm(mean - axes @ (axes.T @ mean))])


def measure(predicted, truth):
    """Precision and coverage."""
    return np.array(chamfer_distance(predicted, truth))


def measure_exactly(predicted, truth):
    """All pairs, in long double."""
    away = predicted[:, None] - truth[None]
    distances = np.sqrt(np.sum(away * away, axis=-1))
    return np.array([np.mean(distances.min(axis=1)), np.mean(distances.min(axis=0))])


def summarize(errors):
    """Accuracy, median and share of flips."""
    return np.array(pose_summary(errors)[:3])


def list_cases() -> list[Case]:
    """The catalogue's cases on evaluation, which is numpy in float64."""
    make = functools.partial(
        Case,
        subject=SUBJECT,
        value_tolerance=64,
        gradient_tolerance=None,
        because="a few dozen roundings",
        is_traced=False,
    )
    cases = []
    half = np.array([0.5, 0.5, -0.5, 0.5])
    near = np.array([1, 1e-7, 0, 0])
    for name, quaternions, mean in (
        ("q and -q", [half, -half, half, -half], half),
        ("lengths 1e-30 and 1e30", [half * 1e-30, half * 1e30], half),
        ("1e-7 from each other", [near, near * [1, -1, 1, 1]], near * [1, 0, 0, 0]),
        ("one alone", [PLAIN], PLAIN),
    ):
        oracle = functools.partial(_square, mean)
        cases.append(
            make(
                name=f"average: {name}",
                function=average,
                inputs=(quaternions,),
                oracle=oracle,
            )
        )
    cases.append(
        make(
            name="average: half a turn apart",
            function=average_opposites,
            inputs=([[1, 0, 0, 0], [0, 0.6, 0, 0.8]],),
            oracle=lambda quaternions: np.array([1, 0]),
            limit=AMBIGUOUS,
        )
    )
    for name, first, second in (
        ("equal", PLAIN, PLAIN),
        ("q and -q", PLAIN, -PLAIN),
        ("half a turn", (1, 0, 0, 0), (0, 0, 1, 0)),
        ("1e-12 apart", (1, 1e-12, 0, 0), (1, 0, 0, 0)),
        ("lengths 1e-200 and 1e200", PLAIN * 1e-200, PLAIN[::-1] * 1e200),
    ):
        cases.append(
            make(
                name=f"angle in degrees: {name}",
                function=rotation_angle_deg,
                inputs=(first, second),
                oracle=lambda p, q: np.asarray(oracles.angle(p, q) * 180 / oracles.PI),
                # Of equal rotations: a rounding of the product, in degrees.
                floor=180.0 if name in ("equal", "q and -q") else 0.0,
            )
        )
    for name, predicted, truth in (
        ("plain", CLOUD, CLOUD[::-1] + 0.05),
        ("identical", CLOUD, CLOUD),
        ("coincident points", CLOUD * 0, CLOUD * 0),
        ("one point", CLOUD[:1], CLOUD),
        ("1e6 away", CLOUD + 1e6, CLOUD),
        ("1e-150 wide", CLOUD * 1e-150, CLOUD[:2] * 1e-150),
        ("1e150 wide", CLOUD * 1e150, CLOUD[:2] * 1e150),
    ):
        cases.append(
            make(
                name=f"chamfer: {name}",
                function=measure,
                inputs=(predicted, truth),
                oracle=measure_exactly,
            )
        )
    for name, errors, expected in (
        ("all right", [0.0, 0.0], (1, 0, 0)),
        ("exactly at the thresholds", [30.0, 150.0], (0.5, 90, 0)),
        ("exactly half a turn", [180.0], (0, 180, 1)),
    ):
        cases.append(
            make(
                name=f"pose summary: {name}",
                function=summarize,
                inputs=(errors,),
                oracle=lambda errors, expected=expected: np.array(expected, REAL),
            )
        )
    return cases


def _square(mean, quaternions):
    mean = oracles.normalize(np.asarray(mean, REAL))
    return np.outer(mean, mean)
