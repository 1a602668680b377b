"""Learning: ties between candidates, empty and full views, ends of schedules."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Render, Train
from dpc_jax.learning import half_turns, losses, schedules
from dpc_jax.learning.choice import hindsight
from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import WIDE, Case, make_cases
from dpc_jax.render import Camera, VoxelGrid, project

SUBJECT = "learning"
FIT_SHAPE = (4, 4, 4)


def list_cases() -> list[Case]:
    """The catalogue's cases on the hindsight choice, fits of one view and schedules."""
    return [*_list_choices(), *_list_fits(), *_list_schedules()]


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


def _list_choices():
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


def _fit(points, rotation, target):
    """Loss of one view of a cloud, whose gradient training takes."""
    image = project(
        points, rotation, sigma=0.7, scale=2.0, grid=VoxelGrid(FIT_SHAPE)
    ).silhouette
    assert image is not None
    return losses.reprojection_loss(image, target)


def _find_fit(points, rotation, target):
    """The oracle of `_fit`."""
    colors = np.zeros((len(points), 1))
    silhouette, _, _ = image_oracles.render(
        points, rotation, 0.7, 2.0, colors, shape=FIT_SHAPE
    )
    return np.sum((silhouette - target) * (silhouette - target))


def _list_fits():
    points = np.array([[0.3, 0.1, 0.0], [-0.2, 0.24, 0.1], [0.1, -0.3, 0.2]])
    pose = (0.8, 0.1, -0.3, 0.2)
    rows = (
        ("empty silhouette", points, pose, EMPTY),
        ("full silhouette", points, pose, EMPTY + 1),
        ("full silhouette, no point seen", points + 9, pose, EMPTY + 1),
        ("full silhouette, coincident points", points[[0, 0, 0]], pose, EMPTY + 1),
    )
    return make_cases(
        "fit of a view",
        *(_fit, _find_fit, (128, 1024), rows),
        because="coordinates of a few cells carry 30 roundings, the kernel multiplies "
        "them by its slope, and 16 pixels are summed",
        dtypes=WIDE,
    )


_RENDER = Render(grid=8, sigma_start=0.1, sigma_end=0.01, anneal_until=0.8)
_TRAIN = Train(steps=1000, learning_rate=1e-3, warmup_steps=100, final_rate=0.02)
# Runs in miniature, with every schedule in use.
SCHEDULES = {
    "plain": (_RENDER, _TRAIN),
    "one step": (_RENDER, dataclasses.replace(_TRAIN, steps=1, warmup_steps=0)),
    "no annealing, constant rate": (
        dataclasses.replace(_RENDER, anneal_until=1.0),
        dataclasses.replace(_TRAIN, final_rate=1.0, warmup_steps=0),
    ),
}


def _compute_schedules(step, *, render, train):
    rate = schedules.make_learning_rate(train)
    return schedules.compute_sigma(step, render, steps=train.steps), rate(step)


def _find_schedules(step, *, render, train):
    """The oracle of `_compute_schedules`."""
    done = min(max(float(step) / (render.anneal_until * train.steps), 0), 1)
    share = render.sigma_start + done * (render.sigma_end - render.sigma_start)
    warm = train.warmup_steps
    peak, last = train.learning_rate, train.final_rate
    if step < warm:
        rate = peak / warm + (peak - peak / warm) * float(step) / warm
    else:
        part = min((float(step) - warm) / (train.steps - warm), 1)
        rate = peak * ((1 - last) * (1 + np.cos(np.pi * part)) / 2 + last)
    return np.asarray(share * render.grid), np.asarray(rate)


def _list_schedules():
    for name, (render, train) in SCHEDULES.items():
        steps = {0, 100, 800, train.steps - 1, train.steps, 10**6}
        sections = {"render": render, "train": train}
        yield from make_cases(
            "schedules",
            functools.partial(_compute_schedules, **sections),
            functools.partial(_find_schedules, **sections),
            (256, None),
            [(f"{name}, step {step}", step) for step in sorted(steps)],
            because="a cosine whose argument has the rounding of a step's share; the "
            "first rate is a hundredth of the difference it comes from",
            dtypes=("float32",),
        )
