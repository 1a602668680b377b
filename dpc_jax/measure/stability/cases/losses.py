"""Losses at ties, opposites, empty and full silhouettes, and far away."""

import jax.numpy as jnp
import numpy as np

from dpc_jax.learning import losses
from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import DTYPES, REAL, WIDE, Case

SUBJECT = "losses"
SUMS = "a few roundings for each of a few terms"


def list_cases() -> list[Case]:
    """The catalogue's cases on losses."""
    return [
        *_list_reprojections(),
        *_list_students(),
        *_list_selections(),
        *_list_priors(),
    ]


def _list_reprojections():
    grey = np.linspace(0, 1, 9).reshape(3, 3)
    pairs = {
        "plain": (grey, grey.T),
        "equal": (grey, grey),
        "both empty": (0 * grey, 0 * grey),
        "both full": (0 * grey + 1, 0 * grey + 1),
        "empty against full": (0 * grey, 0 * grey + 1),
        "1e-7 apart": (grey, grey - 1e-7),
        "colours 1e6": (grey * 1e6, grey.T * 1e6),
    }
    for name, pair in pairs.items():
        yield Case(
            name=f"reprojection: {name}",
            subject=SUBJECT,
            function=losses.reprojection_loss,
            inputs=pair,
            oracle=lambda a, b: np.asarray(np.sum((a - b) * (a - b))),
            value_tolerance=16,
            gradient_tolerance=4,
            because=SUMS,
            dtypes=WIDE if "e" in name and "1" in name else DTYPES,
        )


def find_student_loss(student, teacher):
    """1 - |cos| of unit quaternions; at cos = 0 the slope towards +teacher."""
    cosine = np.sum(oracles.normalize(student) * oracles.normalize(np.real(teacher)))
    return np.asarray(1 - np.where(np.real(cosine) < 0, -cosine, cosine))


def _list_students():
    half_turn = "at 180°, a kink: the gradient towards +teacher"
    plain = (0.5, -1.0, 2.0, 0.25)
    pairs = {
        "plain": (plain, (1, 2, 3, 4), ""),
        "equal": ((0.5,) * 4, (0.5,) * 4, ""),
        "q and -q": ((0.5,) * 4, (-0.5,) * 4, ""),
        "opposite, 180°": ((1, 0, 0, 0), (0, 0, 1, 0), half_turn),
        "opposite, 1e-7 beside": ((1, 0, 1e-7, 0), (0, 0, 1, 0), ""),
        "opposite, 1e-7 beyond": ((1, 0, -1e-7, 0), (0, 0, 1, 0), ""),
        "1e-30 and 1e30": (np.multiply(plain, 1e-30), (1e30, 2e30, 0, 0), ""),
        "a student of 0": ((0,) * 4, (1, 2, 3, 4), "zero counts as the identity"),
    }
    for name, (student, teacher, limit) in pairs.items():
        is_zero = "of 0" in name
        yield Case(
            name=f"student: {name}",
            subject=SUBJECT,
            function=losses.student_loss,
            inputs=(student, teacher),
            oracle=find_student_loss,
            value_tolerance=8,
            gradient_tolerance=16,
            because="cosine and two norms; the gradient cancels along q",
            floor=1.0,
            gradient_floor=1.0,
            slope=(lambda inputs, weights: (np.zeros(4),) * 2) if is_zero else None,
            limit=limit,
            dtypes=WIDE if "1e-" in name else DTYPES,
        )


WINNERS = np.array([0, 2])


def select(logits):
    """The selection loss with fixed winners."""
    return losses.selection_loss(logits, jnp.asarray(WINNERS))


def _list_selections():
    def find(logits):
        total = 0
        for row, winner in zip(logits, WINNERS, strict=True):
            top = max(row, key=np.real)
            total = total + top + np.log(np.sum(np.exp(row - top))) - row[winner]
        return np.asarray(total / len(logits))

    logits = np.array([[1.0, -2, 0.5], [0.25, 3, -1]])
    for name, values in {
        "plain": logits,
        "exact ties": logits * 0,
        "logits 1e4": logits * 1e4,
        "logits 1e30": logits * 1e30,
        "a sure winner": np.array([[50.0, 0, 0], [0, 0, 80]]),
    }.items():
        yield Case(
            name=f"selection: {name}",
            subject=SUBJECT,
            function=select,
            inputs=(values,),
            oracle=find,
            value_tolerance=16,
            gradient_tolerance=16,
            because=SUMS,
            floor=1.0,
            gradient_floor=1.0,
            dtypes=WIDE if "1e" in name else DTYPES,
        )


def _list_priors():
    cloud = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
    same = np.repeat(cloud[:1], 3, axis=0)

    def repel(points):
        pairs = [(i, j) for i in range(3) for j in range(3) if i != j]
        soft = REAL(0.02)
        total = 0
        for i, j in pairs:
            away = points[i] - points[j]
            total = total + 1 / np.sqrt(np.sum(away * away) + soft * soft)
        return np.asarray(total / len(pairs))

    def contain(points):
        total = REAL(0)
        for point in points:
            if np.real(np.sum(point * point)) > 0.25:
                beyond = np.sqrt(np.sum(point * point)) - REAL(0.5)
                total = total + beyond * beyond
        return np.asarray(total)

    scenes = {
        "plain": cloud,
        "coincident points": same,
        "1e-20 apart": same * 0 + np.arange(3)[:, None] * 1e-20,
        "1e6 wide": cloud * 1e6,
        "1e15 wide": cloud * 1e15,
        "exactly on the sphere": np.array([[0.5, 0, 0], [0, -0.5, 0], [0, 0, 0]]),
    }
    for name, points in scenes.items():
        for title, function, oracle in (
            ("repulsion", losses.repulsion_energy, repel),
            ("containment", losses.containment_loss, contain),
        ):
            yield Case(
                name=f"{title}: {name}",
                subject=SUBJECT,
                function=function,
                inputs=(points,),
                oracle=oracle,
                value_tolerance=64,
                gradient_tolerance=256,
                because="differences of coordinates, squared and rooted; a softening "
                "of 1/50 magnifies what is near",
                half="finite",
                gradient_floor=1.0 if "sphere" in name or "plain" in name else 0.0,
                dtypes=WIDE if "1e" in name else DTYPES,
            )
