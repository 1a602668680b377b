"""Learning: ties between candidates, empty and full views, ends of schedules."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Render, Train
from dpc_jax.learning import half_turns, hindsight, losses, schedules
from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import WIDE, Case
from dpc_jax.render import Camera, VoxelGrid, project

SUBJECT = "learning"
FIT_SHAPE = (4, 4, 4)


def list_cases() -> list[Case]:
    """The catalogue's cases on the hindsight choice, fits of one view and schedules."""
    return [*_list_choices(), *_list_fits(), *_list_schedules()]


def choose(points, candidates, target):
    """The winner's index, as a float so that the table can hold it."""
    index = hindsight.choose_candidate(
        points,
        jnp.ones((), points.dtype),
        candidates,
        target,
        sigma=jnp.asarray(0.7, points.dtype),
        camera=Camera(),
    )
    return index.astype(points.dtype)


def turn_about(covariance):
    """Half turns about principal axes, as q·qᵀ summed: the axes of a tie are free."""
    turns = half_turns.find_half_turns(covariance)
    return jnp.einsum("ti,tj->ij", turns, turns)


def _list_choices():
    points = np.array([[0.3, 0.1, 0.0], [-0.2, 0.25, 0.1], [0.1, -0.3, 0.2]])
    identity, turned = (1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)
    # The image of `points` unturned, to the nearest tenth.
    seen = np.zeros((4, 4))
    seen[3, 1] = seen[2, 3] = seen[0, 2] = 1.0
    scenes = {
        "identical candidates": ([turned] * 3, seen, 0),
        "q and -q tie": ([turned, identity, np.negative(identity)], seen, 1),
        "empty silhouette, no point seen": ([identity, turned, turned], 0 * seen, 0),
        "full silhouette, identical candidates": ([turned] * 3, 0 * seen + 1, 0),
    }
    for name, (candidates, target, index) in scenes.items():
        is_away = "no point seen" in name
        yield Case(
            name=f"choice: {name}",
            subject=SUBJECT,
            function=choose,
            inputs=(points + 9 * is_away, candidates, target),
            oracle=lambda points, candidates, target, index=index: np.asarray(index),
            value_tolerance=0,
            gradient_tolerance=None,
            because="an index; of equal candidates the first",
            dtypes=WIDE,
        )
    for name, covariance in {
        "plain": np.diag([3.0, 2, 1]),
        "equal axes": np.eye(3),
        "zero": np.zeros((3, 3)),
        "a line": np.diag([1.0, 0, 0]),
        "entries 1e-30": np.eye(3) * 1e-30,
    }.items():
        yield Case(
            name=f"half turns: {name}",
            subject=SUBJECT,
            function=turn_about,
            inputs=(covariance,),
            oracle=lambda covariance: np.eye(4),
            value_tolerance=16,
            gradient_tolerance=None,
            because="orthonormal axes, to a few roundings",
            dtypes=WIDE,
        )


def fit(points, rotation, target):
    """Loss of one view of a cloud, of which training takes the gradient."""
    image = project(
        points, rotation, sigma=0.7, scale=2.0, grid=VoxelGrid(FIT_SHAPE)
    ).silhouette
    return losses.reprojection_loss(image, target)


def _list_fits():
    def expect(points, rotation, target):
        silhouette, _, _ = image_oracles.render(
            points, rotation, 0.7, 2.0, np.zeros((len(points), 1)), shape=FIT_SHAPE
        )
        return np.asarray(np.sum((silhouette - target) * (silhouette - target)))

    points = np.array([[0.3, 0.1, 0.0], [-0.2, 0.24, 0.1], [0.1, -0.3, 0.2]])
    empty = np.zeros(FIT_SHAPE[:2])
    for name, (cloud, target) in {
        "empty silhouette": (points, empty),
        "full silhouette": (points, empty + 1),
        "full silhouette, no point seen": (points + 9, empty + 1),
        "full silhouette, coincident points": (points * 0 + points[0], empty + 1),
    }.items():
        yield Case(
            name=f"fit of a view: {name}",
            subject=SUBJECT,
            function=fit,
            inputs=(cloud, (0.8, 0.1, -0.3, 0.2), target),
            oracle=expect,
            value_tolerance=128,
            gradient_tolerance=1024,
            because="coordinates of a few cells carry 30 roundings, the kernel "
            "multiplies them by its slope, and 16 pixels are summed",
            dtypes=WIDE,
        )


class Schedules(NamedTuple):
    """Sections of a config that hold its schedules."""

    render: Render
    train: Train


def make_sections(**changes) -> Schedules:
    """A run in miniature, with every schedule in use."""
    render = dict(grid=8, sigma_start=0.1, sigma_end=0.01, anneal_until=0.8)
    train = dict(steps=1000, learning_rate=1e-3, warmup_steps=100, final_rate=0.02)
    for name, value in changes.items():
        (render if name in render else train)[name] = value
    return Schedules(Render(**render), Train(**train))


@functools.cache
def make_schedules(sections: Schedules):
    """(sigma, learning rate) of a step."""
    rate = schedules.make_learning_rate(sections.train)

    def compute(step):
        steps = sections.train.steps
        return schedules.compute_sigma(step, sections.render, steps=steps), rate(step)

    return compute


def _list_schedules():
    def expect(step, *, sections):
        render, train = sections
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

    kinds = {
        "plain": make_sections(),
        "one step": make_sections(steps=1, warmup_steps=0),
        "no annealing, constant rate": make_sections(
            anneal_until=1.0, final_rate=1.0, warmup_steps=0
        ),
    }
    for name, sections in kinds.items():
        last = sections.train.steps
        for step in sorted({0, 100, 800, last - 1, last, 10**6}):
            yield Case(
                name=f"schedules: {name}, step {step}",
                subject=SUBJECT,
                function=make_schedules(sections),
                inputs=(step,),
                oracle=functools.partial(expect, sections=sections),
                value_tolerance=256,
                gradient_tolerance=None,
                because="a cosine whose argument has the rounding of a step's share; "
                "the first rate is a hundredth of the difference it comes from",
                floor=0.0,
                dtypes=("float32",),
            )
