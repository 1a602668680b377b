"""Losses at ties and far away, the choice of candidates, scores of evaluation."""

import functools
import itertools

import jax.numpy as jnp
import numpy as np

from dpc_jax.evaluation import (
    chamfer_distance,
    pose_summary,
    rotation_angle_deg,
    rotations,
)
from dpc_jax.learning import half_turns, losses
from dpc_jax.learning.choice import hindsight
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.case import IN_WIDE, WIDE, Case, make_cases
from dpc_jax.measure.stability.oracles import REAL
from dpc_jax.render import Camera

GREY = np.linspace(0, 1, 9).reshape(3, 3)
BLACK, WHITE = 0 * GREY, 0 * GREY + 1
IMAGES = (
    ("plain", GREY, GREY.T),
    ("equal", GREY, GREY),
    ("both empty", BLACK, BLACK),
    ("both full", WHITE, WHITE),
    ("empty against full", BLACK, WHITE),
    ("1e-7 apart", GREY, GREY - 1e-7, IN_WIDE),
    ("colours 1e6", GREY * 1e6, GREY.T * 1e6, IN_WIDE),
)
PLAIN = (0.5, -1.0, 2.0, 0.25)
ACROSS = {"limit": "at 180°, a kink: the gradient towards +teacher"}
STUDENT_OF_ZERO = {
    "slope": lambda inputs, weights: (np.zeros(4),) * 2,
    "limit": "zero counts as the identity",
}
STUDENTS = (
    ("plain", PLAIN, (1, 2, 3, 4)),
    ("equal", (0.5,) * 4, (0.5,) * 4),
    ("q and -q", (0.5,) * 4, (-0.5,) * 4),
    ("opposite, 180°", (1, 0, 0, 0), (0, 0, 1, 0), ACROSS),
    ("opposite, 1e-7 beside", (1, 0, 1e-7, 0), (0, 0, 1, 0), IN_WIDE),
    ("opposite, 1e-7 beyond", (1, 0, -1e-7, 0), (0, 0, 1, 0), IN_WIDE),
    ("1e-30 and 1e30", np.multiply(PLAIN, 1e-30), (1e30, 2e30, 0, 0), IN_WIDE),
    ("a student of 0", (0,) * 4, (1, 2, 3, 4), STUDENT_OF_ZERO),
)
WINNERS = np.array([0, 2])
LOGITS = np.array([[1.0, -2, 0.5], [0.25, 3, -1]])
SELECTIONS = (
    ("plain", LOGITS),
    ("exact ties", LOGITS * 0),
    ("logits 1e4", LOGITS * 1e4, IN_WIDE),
    ("logits 1e30", LOGITS * 1e30, IN_WIDE),
    ("a sure winner", [[50.0, 0, 0], [0, 0, 80]]),
)
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
OF_ONE = {"gradient_floor": 1.0}
SAME = np.repeat(CLOUD[:1], 3, axis=0)
CLOUDS = (
    ("plain", CLOUD, OF_ONE),
    ("coincident points", SAME),
    ("1e-20 apart", SAME * 0 + np.arange(3)[:, None] * 1e-20, IN_WIDE),
    ("1e6 wide", CLOUD * 1e6, IN_WIDE),
    ("1e15 wide", CLOUD * 1e15, IN_WIDE),
    ("exactly on the sphere", [[0.5, 0, 0], [0, -0.5, 0], [0, 0, 0]], OF_ONE),
)


def _select(logits):
    return losses.selection_loss(logits, jnp.asarray(WINNERS))


def _find_reprojection_loss(a, b):
    return np.sum((a - b) * (a - b))


def _find_student_loss(student, teacher):
    """1 - |cos| of unit quaternions; at cos = 0 the slope towards +teacher."""
    cosine = np.sum(oracles.normalize(student) * oracles.normalize(np.real(teacher)))
    return 1 - oracles.flip_sign(cosine)


def _find_selection_loss(logits):
    total = 0
    for row, winner in zip(logits, WINNERS, strict=True):
        top = max(row, key=np.real)
        total = total + top + np.log(np.sum(np.exp(row - top))) - row[winner]
    return np.asarray(total / len(logits))


def _find_repulsion(points):
    """Mean of 1/√(d² + 0.02²) over all pairs of points."""
    energies = []
    for i, j in itertools.combinations(range(len(points)), 2):
        away = points[i] - points[j]
        energies.append(1 / np.sqrt(np.sum(away * away) + REAL(0.02) * REAL(0.02)))
    return np.sum(energies) / len(energies)


def _find_containment(points):
    """Sum of squared distances outside the ball of radius a half."""
    total = np.zeros((), REAL)
    for point in points:
        if np.real(np.sum(point * point)) > 0.25:
            beyond = oracles.root_sum(point) - REAL(0.5)
            total = total + beyond * beyond
    return total


def list_losses() -> list[Case]:
    """Cases of the losses."""
    sums = "a few roundings for each of a few terms"
    near = "differences of coordinates, squared and rooted; a softening of 1/50 "
    near += "magnifies what is near"
    of_one = {"floor": 1.0, "gradient_floor": 1.0}
    return [
        *make_cases(
            "reprojection",
            *(losses.reprojection_loss, _find_reprojection_loss, (16, 4), IMAGES),
            because=sums,
        ),
        *make_cases(
            "student",
            *(losses.student_loss, _find_student_loss, (8, 16), STUDENTS),
            because="cosine and two norms; the gradient cancels along q",
            **of_one,
        ),
        *make_cases(
            "selection",
            *(_select, _find_selection_loss, (16, 16), SELECTIONS),
            because=sums,
            **of_one,
        ),
        *make_cases(
            "repulsion",
            *(losses.repulsion_energy, _find_repulsion, (64, 256), CLOUDS),
            because=near,
            half="finite",
        ),
        *make_cases(
            "containment",
            *(losses.containment_loss, _find_containment, (64, 256), CLOUDS),
            because=near,
            half="finite",
        ),
    ]


def _choose(points, candidates, target):
    """The winner's index, as a float so that it is compared like other outputs."""
    index = hindsight.choose_candidate(
        points,
        jnp.ones((), points.dtype),
        candidates,
        target,
        sigma=jnp.asarray(0.7, points.dtype),
        camera=Camera(),
    )
    return index.astype(points.dtype)


def _sum_half_turns(covariance):
    """Σ q·qᵀ of the half turns about the principal axes.

    The sum is the same for every choice of the axes, which are arbitrary in a tie.
    """
    turns = half_turns.find_half_turns(covariance)
    return jnp.einsum("ti,tj->ij", turns, turns)


IDENTITY, TURNED = (1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)
POINTS = np.array([[0.3, 0.1, 0.0], [-0.2, 0.25, 0.1], [0.1, -0.3, 0.2]])
EMPTY = np.zeros((4, 4))
# The silhouette of `POINTS` without rotation, rounded.
SEEN = EMPTY.copy()
SEEN[3, 1] = SEEN[2, 3] = SEEN[0, 2] = 1.0
# name, points, candidates, target, the winner
CHOICES = (
    ("identical candidates", POINTS, [TURNED] * 3, SEEN, 0),
    ("q and -q tie", POINTS, [TURNED, IDENTITY, np.negative(IDENTITY)], SEEN, 1),
    (
        "empty silhouette, no point seen",
        *(POINTS + 9, [IDENTITY, TURNED, TURNED], EMPTY, 0),
    ),
    ("full silhouette, identical candidates", POINTS, [TURNED] * 3, EMPTY + 1, 0),
)
COVARIANCES = (
    ("plain", np.diag([3.0, 2, 1])),
    ("equal axes", np.eye(3)),
    ("zero", np.zeros((3, 3))),
    ("a line", np.diag([1.0, 0, 0])),
    ("entries 1e-30", np.eye(3) * 1e-30),
)


def list_choices() -> list[Case]:
    """Cases of the hindsight choice and of half turns."""
    make = functools.partial(make_cases, dtypes=WIDE)
    rows = [
        (*row, {"oracle": lambda *inputs, winner=winner: np.asarray(winner)})
        for *row, winner in CHOICES
    ]
    return [
        *make(
            "choice",
            *(_choose, None, (0, None), rows),
            because="an index; of equal candidates the first",
        ),
        *make(
            "half turns",
            *(_sum_half_turns, lambda covariance: np.eye(4), (16, None), COVARIANCES),
            because="orthonormal axes, to a few roundings",
        ),
    ]


UNEVEN = np.array([0.5, -1.0, 2.0, 0.25])
HALF = np.array([0.5, 0.5, -0.5, 0.5])
NEAR = np.array([1, 1e-7, 0, 0])
FEW = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
# name, quaternions, their mean
MEANS = (
    ("q and -q", [HALF, -HALF, HALF, -HALF], HALF),
    ("lengths 1e-30 and 1e30", [HALF * 1e-30, HALF * 1e30], HALF),
    ("1e-7 from each other", [NEAR, NEAR * [1, -1, 1, 1]], NEAR * [1, 0, 0, 0]),
    ("one alone", [UNEVEN], UNEVEN),
)
OPPOSITE = [[1, 0, 0, 0], [0, 0.6, 0, 0.8]]
AMBIGUOUS = "of two rotations half a turn apart every one between is a mean; one comes"
# Equal rotations have an angle of zero; the rounding of a product, in degrees, is left.
EQUAL = {"floor": 180.0}
TURNS = (
    ("equal", UNEVEN, UNEVEN, EQUAL),
    ("q and -q", UNEVEN, -UNEVEN, EQUAL),
    ("half a turn", (1, 0, 0, 0), (0, 0, 1, 0)),
    ("1e-12 apart", (1, 1e-12, 0, 0), (1, 0, 0, 0)),
    ("lengths 1e-200 and 1e200", UNEVEN * 1e-200, UNEVEN[::-1] * 1e200),
)
PAIRS = (
    ("plain", FEW, FEW[::-1] + 0.05),
    ("identical", FEW, FEW),
    ("coincident points", FEW * 0, FEW * 0),
    ("one point", FEW[:1], FEW),
    ("1e6 away", FEW + 1e6, FEW),
    ("1e-150 wide", FEW * 1e-150, FEW[:2] * 1e-150),
    ("1e150 wide", FEW * 1e150, FEW[:2] * 1e150),
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


def list_scores() -> list[Case]:
    """Cases of evaluation, which is numpy in float64."""
    because = "a few dozen roundings"
    make = functools.partial(make_cases, because=because, is_traced=False)

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
        *make("angle in degrees", rotation_angle_deg, _find_angle, (64, None), TURNS),
        *make("chamfer", _measure, _measure_exactly, (64, None), PAIRS),
        *make("pose summary", _summarize, None, (64, None), summaries),
    ]


CASES = {"loss": list_losses, "choice": list_choices, "evaluation": list_scores}
