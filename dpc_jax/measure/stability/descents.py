"""Stiff optimisation: points and poses from six silhouettes of a thin object.

Points start in a ball, poses 30° off, and one known pose holds the frame. A point's
curvature grows with the square of its mass: with masses of 10⁴ : 1 the condition number
is about 10⁸.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import draw_ball, make_scenes
from dpc_jax.measure.stability.runner import QUICKLY, Row
from dpc_jax.render import Camera, VoxelGrid, project, quaternion

Array = jax.Array | np.ndarray
VIEWS = 6
OFF_DEG = 30.0  # of the first poses from the true ones
BEST = "Adam, σ 2 → 0.5"
# First and last sigma in voxels, rate of plain gradient descent, or None for Adam.
RECIPES = {
    "gradient, σ 1, rate 1e-4": ((1.0, 1.0), 1e-4),
    "gradient, σ 1, rate 4e-4": ((1.0, 1.0), 4e-4),
    "gradient, σ 0.2": ((0.2, 0.2), 1e-4),
    "Adam, σ 5": ((5.0, 5.0), None),
    "Adam, σ 1": ((1.0, 1.0), None),
    "Adam, σ 0.2": ((0.2, 0.2), None),
    BEST: ((2.0, 0.5), None),
}
# Problems by name: the object, and the mass of the heaviest point over the lightest.
PROBLEMS = {
    "car": ("car", 1.0),
    "chair": ("chair", 1.0),
    "chair, masses 1e4 : 1": ("chair", 1e4),
}
# Errors that the best recipe may leave, medians over seeds. Descents are chaotic, and
# another processor rounds differently: a fifth above the worst single seed measured
# (6.7°, 7.8; they start at 30° and 12 to 15).
BOUNDS = {"pose error (degrees)": 8.0, "Chamfer distance (x100)": 9.5}
_GRID = VoxelGrid(32)
_DENSE = 2000  # points that targets are rendered from


class Plan(NamedTuple):
    """How much is run."""

    steps: int  # iterations
    points: int  # to find
    seeds: int  # of views, starts and surfaces
    problems: tuple[str, ...]  # of `PROBLEMS`


FULL = Plan(400, 600, 3, tuple(PROBLEMS))
QUICK = Plan(40, 24, 1, tuple(PROBLEMS)[1:])


class Problem(NamedTuple):
    """Silhouettes of one object, the truth behind them, and where a descent starts."""

    targets: jax.Array  # [V, 32, 32] silhouettes
    poses: jax.Array  # [V, 4] true quaternions
    surface: jax.Array  # [N, 3] true points
    masses: jax.Array  # [N] of the points to find, in voxels
    start: tuple[jax.Array, jax.Array]  # points [N, 3] and poses [V, 4]


class Recipe(NamedTuple):
    """How to descend; all of it traced, so that one program serves every recipe."""

    sigmas: Array  # [T] standard deviation of a point at each iteration, voxels
    rates: Array  # [T] learning rates, in object units and units of a quaternion
    is_adam: Array  # () whether to take Adam's direction instead of the gradient


class Errors(NamedTuple):
    """Errors before the first iteration, and after the last."""

    losses: Array  # [2, V] reprojection loss of each view at sigma one
    angles: Array  # [2, V] of the poses, degrees
    chamfer: Array  # [2] in the paper's units (×100)


def run(*, quick: bool, seed: int = 0) -> Iterator[Row]:
    """Rows of all descents of the plan: all stay finite, the best recipe arrives."""
    plan, options = (QUICK, QUICKLY) if quick else (FULL, None)
    program = jax.jit(descend, compiler_options=options)
    for name in plan.problems:
        seeds = range(seed, seed + plan.seeds)
        problems = [_make_problem(name, plan, s) for s in seeds]
        for words, (ends, rate) in RECIPES.items():
            recipe = _make_recipe(plan, ends, rate)
            found = [jax.device_get(program(p, recipe)) for p in problems]
            yield judge(f"{name}, {words}", found, plan, words == BEST)


def judge(name: str, found: Sequence[Errors], plan: Plan, is_best: bool) -> Row:
    """The row of one recipe: the loss, and medians over seeds of the other errors.

    The loss of the best recipe must fall; bounds belong to the full plan's iterations.
    """
    first, last = np.sum([e.losses for e in found], axis=(0, 2))
    values = (
        np.median([np.median(e.angles[1, 1:]) for e in found]),
        np.median([e.chamfer[1] for e in found]),
    )
    errors = {"last loss over first": (float(last / first), 1.0 if is_best else None)}
    for (words, bound), value in zip(BOUNDS.items(), values, strict=True):
        errors[words] = float(value), bound if is_best and plan == FULL else None
    is_finite = all(np.all(np.isfinite(a)) for a in jax.tree.leaves(list(found)))
    return Row("descent", name, "float32", errors, is_finite)


def descend(problem: Problem, recipe: Recipe) -> Errors:
    """Follow a recipe from the start."""

    def compute_loss(params, sigma):
        images = _render_views(*params, masses=problem.masses, sigma=sigma)
        return reprojection_loss(images, problem.targets)

    # Adam's own epsilon would hold light points still.
    adam = optax.scale_by_adam(eps=1e-30)

    def step(carry, inputs):
        sigma, rate = inputs
        params, state = carry
        gradient = jax.grad(compute_loss)(params, sigma)
        # The first pose is known and fixes the frame.
        gradient = gradient[0], gradient[1].at[0].set(0)
        scaled, state = adam.update(gradient, state)

        def move(param, plain, scaled):
            return param - rate * jnp.where(recipe.is_adam, scaled, plain)

        return (jax.tree.map(move, params, gradient, scaled), state), None

    def measure(params):
        sharp = _render_views(*params, masses=problem.masses, sigma=1.0)
        losses = jnp.sum((sharp - problem.targets) ** 2, axis=(1, 2))
        points, poses = params
        angles = jax.vmap(quaternion.angle_between)(poses, problem.poses)
        gaps = jnp.linalg.norm(points[:, None] - problem.surface[None], axis=-1)
        chamfer = 100 * (jnp.mean(jnp.min(gaps, 1)) + jnp.mean(jnp.min(gaps, 0)))
        return Errors(losses, jnp.degrees(angles), chamfer)

    begin = problem.start, adam.init(problem.start)
    (end, _), _ = jax.lax.scan(step, begin, (recipe.sigmas, recipe.rates))
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), problem.start, end)
    return jax.lax.map(measure, both)


def _render_views(points, poses, *, masses, sigma) -> jax.Array:
    """Silhouettes [V, 32, 32] of points [N, 3] with masses [N] from poses [V, 4]."""
    looks = {"sigma": sigma, "scale": masses, "camera": Camera(), "grid": _GRID}
    return jax.lax.map(lambda q: project(points, q, **looks).silhouette, poses)


def _make_problem(name, plan, seed) -> Problem:
    """Nearly sharp targets of an object; points start in a ball."""
    scene, ratio = PROBLEMS[name]
    scenes = make_scenes(num_points=_DENSE, num_sparse=64, seed=seed)
    (cloud,) = (s.points for s in scenes if s.name == scene)
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(VIEWS, 4)).astype(np.float32)
    poses = jnp.asarray(poses / np.linalg.norm(poses, axis=1, keepdims=True))
    surface = jnp.asarray(cloud, jnp.float32)
    targets = _render_views(surface, poses, masses=jnp.full(_DENSE, 2.0), sigma=0.5)
    # The total mass depends on neither their number nor their ratio.
    masses = np.geomspace(ratio, 1, plan.points)
    masses = jnp.asarray(2400 * masses / masses.sum(), jnp.float32)
    ball = draw_ball(rng, plan.points, radius=0.3)
    axes = rng.normal(size=(VIEWS, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turn = jax.vmap(quaternion.from_axis_angle, in_axes=(0, None))
    turns = turn(jnp.asarray(axes, jnp.float32), np.radians(OFF_DEG))
    turned = jax.vmap(quaternion.multiply)(turns, poses).at[0].set(poses[0])
    start = jnp.asarray(ball, jnp.float32), turned
    return Problem(targets, poses, surface[: plan.points], masses, start)


def _make_recipe(plan, ends: tuple[float, float], rate) -> Recipe:
    """Gradient descent at a rate, or Adam, whose rate decays by a cosine.

    log sigma goes evenly between its ends.
    """
    decay = 0.5 * (1 + np.cos(np.pi * np.arange(plan.steps) / plan.steps))
    rates = np.full(plan.steps, rate) if rate else 0.01 * decay
    numbers = np.geomspace(*ends, plan.steps), rates
    sigmas, rates = (jnp.asarray(a, jnp.float32) for a in numbers)
    return Recipe(sigmas, rates, jnp.asarray(rate is None))
