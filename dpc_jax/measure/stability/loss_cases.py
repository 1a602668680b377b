"""Losses at ties, at kinks and far away."""

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning import losses
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.case import IN_WIDE, SKEW, make_cases
from dpc_jax.measure.stability.oracles import REAL
from dpc_jax.measure.stability.runner import tabulate

GREY = np.linspace(0, 1, 9).reshape(3, 3)
IMAGES = (
    ("plain", GREY, GREY.T),
    ("equal", GREY, GREY),
    ("empty against full", 0 * GREY, 0 * GREY + 1),
    ("1e-7 apart", GREY, GREY - 1e-7, IN_WIDE),
    ("colours 1e6", GREY * 1e6, GREY.T * 1e6, IN_WIDE),
)
STUDENTS = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("equal", (0.5,) * 4, (0.5,) * 4),
    ("q and -q", (0.5,) * 4, (-0.5,) * 4),
    ("opposite, 180°", (1, 0, 0, 0), (0, 0, 1, 0)),
    ("opposite, 1e-7 beyond", (1, 0, -1e-7, 0), (0, 0, 1, 0), IN_WIDE),
    ("1e-30 and 1e30", np.multiply(SKEW, 1e-30), (1e30, 2e30, 0, 0), IN_WIDE),
    ("a student of 0", (0,) * 4, (1, 2, 3, 4)),
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


def select(logits: jax.Array) -> jax.Array:
    """`selection_loss` of two rows of three logits."""
    return losses.selection_loss(logits, jnp.asarray(WINNERS))


def _find_reprojection_loss(a, b):
    return np.sum((a - b) * (a - b))


def _find_student_loss(student, teacher):
    """1 - |cos| of unit quaternions; at cos = 0 the slope towards +teacher."""
    cosine = np.sum(oracles.normalize(student) * oracles.normalize(np.real(teacher)))
    return 1 - oracles.flip_sign(cosine)


def _find_selection_loss(logits):
    top = np.max(np.real(logits), axis=1, keepdims=True)
    sums = np.log(np.sum(np.exp(logits - top), axis=1, keepdims=True))
    return np.mean(top + sums - np.take_along_axis(logits, WINNERS[:, None], axis=1))


def _find_repulsion(points):
    """Mean of 1/√(d² + 0.02²) over all pairs of points."""
    i, j = np.triu_indices(len(points), 1)
    squares = np.sum((points[i] - points[j]) ** 2, axis=1)
    return np.mean(1 / np.sqrt(squares + REAL(0.02) * REAL(0.02)))


def _find_containment(points):
    """Sum of squared distances outside the ball of radius a half."""
    lengths = np.sqrt(np.sum(points * points, axis=1))
    return np.sum(np.where(np.real(lengths) > 0.5, lengths - REAL(0.5), 0) ** 2)


SUMS = "a few roundings for each of a few terms"
NEAR = {
    "because": "differences of coordinates, squared and rooted; a softening of 1/50 "
    "magnifies what is near",
    "is_half_checked": False,
}
LOSSES = [
    *make_cases(
        "reprojection",
        *(losses.reprojection_loss, _find_reprojection_loss, (16, 4), IMAGES),
        because=SUMS,
    ),
    *make_cases(
        "student",
        *(losses.student_loss, _find_student_loss, (8, 16), STUDENTS),
        because="cosine and two norms; the gradient cancels along q",
        floor=1.0,
        gradient_floor=1.0,
    ),
    *make_cases(
        *("selection", select, _find_selection_loss, (16, 16), SELECTIONS),
        because=SUMS,
        floor=1.0,
        gradient_floor=1.0,
    ),
    *make_cases(
        *("repulsion", losses.repulsion_energy, _find_repulsion, (64, 256), CLOUDS),
        **NEAR,
    ),
    *make_cases(
        *("containment", losses.containment_loss, _find_containment, (64, 256), CLOUDS),
        **NEAR,
    ),
]
ROWS = tabulate(loss=LOSSES)
