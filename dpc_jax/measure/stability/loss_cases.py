"""Losses at ties, at kinks and far away."""

import itertools

import jax.numpy as jnp
import numpy as np

from dpc_jax.learning import losses
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.case import IN_WIDE, Case, make_cases
from dpc_jax.measure.stability.oracles import REAL

GREY = np.linspace(0, 1, 9).reshape(3, 3)
BLACK, WHITE = 0 * GREY, 0 * GREY + 1
IMAGES = (
    ("plain", GREY, GREY.T),
    ("equal", GREY, GREY),
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
    ("opposite, 1e-7 beyond", (1, 0, -1e-7, 0), (0, 0, 1, 0), IN_WIDE),
    ("1e-30 and 1e30", np.multiply(PLAIN, 1e-30), (1e30, 2e30, 0, 0), IN_WIDE),
    ("a student of 0", (0,) * 4, (1, 2, 3, 4), STUDENT_OF_ZERO),
)
WINNERS = np.array([0, 2])
LOGITS = np.array([[1.0, -2, 0.5], [0.25, 3, -1]])
SELECTIONS = (
    ("plain", LOGITS),
    ("exact ties", LOGITS * 0),
    ("logits 1e30", LOGITS * 1e30, IN_WIDE),
    ("a sure winner", [[50.0, 0, 0], [0, 0, 80]]),
)
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
OF_ONE = {"gradient_floor": 1.0}
SAME = np.repeat(CLOUD[:1], 3, axis=0)
CLOUDS = (
    ("plain", CLOUD, OF_ONE),
    ("beyond the sphere", CLOUD * 1.5, OF_ONE),
    ("coincident points", SAME),
    ("1e-20 apart", SAME * 0 + np.arange(3)[:, None] * 1e-20, IN_WIDE),
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
            is_half_checked=False,
        ),
        *make_cases(
            "containment",
            *(losses.containment_loss, _find_containment, (64, 256), CLOUDS),
            because=near,
            is_half_checked=False,
        ),
    ]


CASES = {"loss": list_losses}
