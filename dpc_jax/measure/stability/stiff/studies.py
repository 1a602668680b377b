"""Three stiff problems, and the recipes of descent that are compared on each."""

import dataclasses
import itertools
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability.stiff.descent import (
    Problem,
    Recipe,
    Start,
    Trace,
    descend,
    render_views,
    turn_randomly,
)

VIEWS = 6
EVERY = 10  # iterations between two measurements of the error
BEST, STAGED = "Adam, σ 2 → 0.5", "Adam, heavy points first"
_OFF_DEG = 30.0  # of the first poses from the true ones
_DENSE = 2000  # points that targets are rendered from
_ADAM_RATE, _START_RATE = 0.01, 0.03  # of Adam; poses alone bear a larger one
_MEMORY = 0.999  # Adam's decay of the mean square
_FEW = 24  # points of the study of masses


@dataclasses.dataclass(frozen=True)
class Plan:
    """How much is run."""

    steps: int = 400  # iterations, a multiple of `EVERY`
    points: int = 600  # to find
    surface: int = 600  # true points that they are compared with
    seeds: int = 3  # of views, starts and surfaces
    starts: int = 8  # K at most
    scenes: tuple[str, ...] = ("car", "chair")  # by name
    sigmas: tuple[float, ...] = (5.0, 2.0, 1.0, 0.5, 0.2)  # fixed ones, in voxels
    # Of plain gradient descent; the best of them is shown
    rates: tuple[float, ...] = (1e-4, 4e-4)


FULL = Plan()
# With as many points as in the study of masses, one program serves all studies.
QUICK = Plan(40, _FEW, _FEW, 1, 2, ("chair",), sigmas=(5.0, 0.2), rates=(1e-4,))


class Run(NamedTuple):
    """One descent."""

    study: str  # "shape", "starts" or "masses"
    scene: str
    recipe: str  # in words
    rate: float | None  # of plain gradient descent, or None
    seed: int  # of the problem
    seconds: float  # wall clock, measurements included, compilation not
    trace: Trace  # errors


def run_shapes(plan: Plan) -> Iterator[Run]:
    """Points and poses from six silhouettes; one known pose fixes the frame.

    Points start in a ball, poses 30° off. Targets are nearly sharp, as masks are.
    """
    for scene, seed in itertools.product(plan.scenes, range(plan.seeds)):
        problem, start = _make_shape(scene, plan, seed)
        for name, ends, rate in _list_recipes(plan):
            recipe = _make_recipe(plan, ends, rate=rate)
            yield _time("shape", scene, name, rate, seed, problem, start, recipe)


def _list_recipes(plan):
    """(name, first and last sigma, rate or None for Adam)."""
    for sigma in plan.sigmas:
        for rate in plan.rates:
            yield f"gradient, σ {sigma:g}", (sigma, sigma), rate
        yield f"Adam, σ {sigma:g}", (sigma, sigma), None
    for rate in plan.rates:
        yield "gradient, σ 2 → 0.5", (2.0, 0.5), rate
    yield "Adam, σ 5 → 0.2", (5.0, 0.2), None
    yield BEST, (2.0, 0.5), None


def run_starts(plan: Plan) -> Iterator[Run]:
    """Poses of six views of a known shape, from random rotations."""
    recipe = _make_recipe(plan, (2.0, 0.5))
    poses = jnp.full((plan.steps, VIEWS), _START_RATE) * _cool(plan)[:, None]
    recipe = recipe._replace(point_rates=0 * recipe.point_rates, pose_rates=poses)
    for scene, seed in itertools.product(plan.scenes, range(plan.seeds)):
        problem, _ = _make_shape(scene, plan, seed)
        for k in range(plan.starts):
            rng = np.random.default_rng((seed, 1000 + k))  # not the one of the views
            start = Start(problem.surface[: plan.points], _draw_poses(rng))
            yield _time("starts", scene, BEST, None, seed, problem, start, recipe)


def run_masses(plan: Plan) -> Iterator[Run]:
    """Points of masses 10 to 0.001 voxels, displaced by 0.02; poses are known."""
    masses = np.geomspace(10, 1e-3, _FEW)
    order = np.arange(_FEW) / _FEW
    steps = np.arange(plan.steps)[:, None]
    # A point starts when the heavier ones have come to rest, with a decay of its own.
    done = (steps - 0.6 * plan.steps * order) / (0.4 * plan.steps)
    staged = np.where(done < 0, 0, 0.5 * (1 + np.cos(np.pi * np.clip(done, 0, 1))))
    flat, still = np.ones((plan.steps, _FEW)), jnp.zeros((plan.steps, VIEWS))
    recipes = [
        *(("gradient", r, flat * r, _MEMORY) for r in (1e-4, 3e-4, 1e-3)),
        *(
            ("gradient / mass", r, flat * r / masses, _MEMORY)
            for r in (3e-4, 1e-3, 3e-3)
        ),
        ("Adam", None, flat * _cool(plan)[:, None] * 0.003, _MEMORY),
        (STAGED, None, staged * 0.003, 0.9),
    ]
    for seed in range(plan.seeds):
        problem, start = _make_cloud(masses, seed)
        for name, rate, rates, memory in recipes:
            point_rates = jnp.asarray(rates, jnp.float32)
            flags = (jnp.asarray(rate is None), jnp.asarray(memory))
            recipe = Recipe(jnp.ones(plan.steps), point_rates, still, *flags)
            yield _time("masses", "sparse", name, rate, seed, problem, start, recipe)


def _make_shape(scene, plan, seed):
    """Nearly sharp targets of a scene, and where points and poses begin."""
    scenes = make_scenes(num_points=_DENSE, num_sparse=64, seed=seed)
    (cloud,) = (s.points for s in scenes if s.name == scene)
    rng = np.random.default_rng(seed)
    poses = _draw_poses(rng)
    surface = jnp.asarray(cloud, jnp.float32)
    dense = jnp.full(_DENSE, 2.0)
    targets = render_views(surface, poses, masses=dense, sigma=0.5)
    # The total mass does not depend on the number of points.
    masses = jnp.full(plan.points, 2400 / plan.points, jnp.float32)
    problem = Problem(targets, poses, surface[: plan.surface], masses)
    directions = rng.normal(size=(plan.points, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = 0.3 * directions * rng.uniform(0, 1, (plan.points, 1)) ** (1 / 3)
    turned = turn_randomly(poses, _OFF_DEG, rng).at[0].set(poses[0])
    return problem, Start(jnp.asarray(ball, jnp.float32), turned)


def _make_cloud(masses, seed):
    rng = np.random.default_rng(seed)
    *_, cloud = make_scenes(num_points=64, num_sparse=len(masses), seed=seed)
    poses = _draw_poses(rng)
    points, masses = (jnp.asarray(a, jnp.float32) for a in (cloud.points, masses))
    targets = render_views(points, poses, masses=masses, sigma=1.0)
    moved = points + jnp.asarray(rng.normal(size=points.shape) * 0.02, jnp.float32)
    return Problem(targets, poses, points, masses), Start(moved, poses)


def _make_recipe(plan, ends: tuple[float, float], *, rate=None):
    """Gradient descent at a rate, or Adam; log sigma goes evenly between its ends."""
    factors = np.ones(plan.steps) if rate else _cool(plan)
    rates = jnp.asarray((rate or _ADAM_RATE) * factors, jnp.float32)[:, None]
    return Recipe(
        jnp.asarray(np.geomspace(*ends, plan.steps), jnp.float32),
        jnp.broadcast_to(rates, (plan.steps, plan.points)),
        # The first pose is known and fixes the frame.
        jnp.broadcast_to(rates, (plan.steps, VIEWS)).at[:, 0].set(0),
        jnp.asarray(rate is None),
        jnp.asarray(_MEMORY),
    )


def _cool(plan):
    """Cosine decay of the learning rate, [T]."""
    return 0.5 * (1 + np.cos(np.pi * np.arange(plan.steps) / plan.steps))


def _draw_poses(rng):
    poses = rng.normal(size=(VIEWS, 4)).astype(np.float32)
    return jnp.asarray(poses / np.linalg.norm(poses, axis=1, keepdims=True))


def _time(study, scene, name, rate, seed, problem, start, recipe):
    # Compiled for its shapes by a first call, which is not timed.
    key = (start.points.shape, problem.surface.shape, recipe.sigmas.shape)
    if key not in _compiled:
        jax.block_until_ready(descend(problem, start, recipe, every=EVERY))
        _compiled.add(key)
    begin = time.perf_counter()
    trace = jax.block_until_ready(descend(problem, start, recipe, every=EVERY))
    seconds = time.perf_counter() - begin
    return Run(study, scene, name, rate, seed, seconds, jax.device_get(trace))


_compiled: set[tuple] = set()
