"""Stiff optimisation: two problems, recipes of descent, and how far each one comes.

Shape: points and poses from six silhouettes of a thin object; points start in a ball,
poses 30° off, and one known pose holds the frame. Masses: points of masses 10⁴ : 1
whose poses are known; a point's curvature grows with the square of its mass, so the
condition number is about 10⁸.
"""

import functools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import draw_ball, make_scenes
from dpc_jax.measure.stability.case import Row
from dpc_jax.measure.stability.runner import QUICKLY
from dpc_jax.render import Camera, VoxelGrid, project, quaternion

Array = jax.Array | np.ndarray
VIEWS = 6
OFF_DEG = 30.0  # of the first poses from the true ones
BEST, STAGED = "Adam, σ 2 → 0.5", "Adam, heavy points first"
# Of the problem of shapes: first and last sigma in voxels, rate of plain gradient
# descent, or None for Adam.
RECIPES = {
    "gradient, σ 1, rate 1e-4": ((1.0, 1.0), 1e-4),
    "gradient, σ 1, rate 4e-4": ((1.0, 1.0), 4e-4),
    "gradient, σ 0.2": ((0.2, 0.2), 1e-4),
    "Adam, σ 5": ((5.0, 5.0), None),
    "Adam, σ 1": ((1.0, 1.0), None),
    "Adam, σ 0.2": ((0.2, 0.2), None),
    BEST: ((2.0, 0.5), None),
}
# Errors that the best recipes may leave, medians over seeds. Descents are chaotic, and
# another processor rounds differently: a fifth above the worst single seed measured for
# shapes (6.7°, 7.8; they start at 30° and 12 to 15), several times the worst of heavy
# points (0.0029 of 3.6), half as much again as that of light ones (0.94 of 3.0).
BOUNDS = {
    "pose error (degrees)": 8.0,
    "Chamfer distance (x100)": 9.5,
    "distance of heavy points (x100)": 0.02,
    "distance of light points (x100)": 1.5,
}
_WHY = "bounds above the worst seed measured: dpc_jax/measure/stability/descents.py"
_GRID = VoxelGrid(32)
_DENSE = 2000  # points that targets are rendered from
_FEW = 24  # points of the problem of masses
_SPREAD = np.geomspace(10, 1e-3, _FEW)  # their masses
_MEMORY = 0.999  # Adam's decay of the mean square, its authors'


class Plan(NamedTuple):
    """How much is run."""

    steps: int  # iterations
    points: int  # to find
    seeds: int  # of views, starts and surfaces
    scenes: tuple[str, ...]  # by name


FULL = Plan(400, 600, 3, ("car", "chair"))
# With as many points as in the problem of masses, one program serves all.
QUICK = Plan(40, _FEW, 1, ("chair",))


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
    point_rates: Array  # [T, N] learning rate of each point, in object units
    pose_rates: Array  # [T, V] learning rate of each pose, in units of a quaternion
    is_adam: Array  # () whether to take Adam's direction instead of the gradient
    memory: Array  # () Adam's decay of the mean square


class Errors(NamedTuple):
    """Errors before the first iteration, and after the last."""

    losses: Array  # [2, V] reprojection loss of each view at sigma one
    angles: Array  # [2, V] of the poses, degrees
    chamfer: Array  # [2] in the paper's units (×100)
    distances: Array  # [2, N] of each point from its true place


def run(*, quick: bool, seed: int = 0, **_) -> Iterator[Row]:
    """Rows of all descents of the plan: all stay finite, the best recipes arrive."""
    plan, options = (QUICK, QUICKLY) if quick else (FULL, None)
    program = jax.jit(descend, compiler_options=options)

    def follow(problem: Problem, recipe: Recipe) -> Errors:
        recipe = Recipe(*(jnp.asarray(a, jnp.float32) for a in recipe))
        return jax.device_get(program(problem, recipe))

    seeds = range(seed, seed + plan.seeds)
    for scene in plan.scenes:
        problems = [_make_shape(scene, plan, s) for s in seeds]
        for name, (ends, rate) in RECIPES.items():
            found = [follow(p, _make_recipe(plan, ends, rate)) for p in problems]
            measures = {
                "pose error (degrees)": [np.median(e.angles[1, 1:]) for e in found],
                "Chamfer distance (x100)": [e.chamfer[1] for e in found],
            }
            is_best = name == BEST
            yield from judge(f"shape, {scene}, {name}", found, measures, plan, is_best)
    for name, recipe in _list_mass_recipes(plan):
        found = [follow(_make_cloud(s), recipe) for s in seeds]
        thirds = {"heavy": slice(_FEW // 3), "light": slice(-_FEW // 3, None)}
        measures = {
            f"distance of {kind} points (x100)": [
                100 * np.sqrt(np.mean(e.distances[1, part] ** 2.0)) for e in found
            ]
            for kind, part in thirds.items()
        }
        yield from judge(f"masses, {name}", found, measures, plan, name == STAGED)


def judge(
    name: str,
    found: Sequence[Errors],
    measures: dict[str, list[np.ndarray]],
    plan: Plan,
    is_best: bool,
) -> Iterator[Row]:
    """Rows of one recipe: the loss, and medians over seeds of its measures.

    The loss of a best recipe must fall; bounds belong to the full plan's iterations.
    """
    row = functools.partial(Row, "descent", dtype="float32", because=_WHY)
    first, last = np.sum([e.losses for e in found], axis=(0, 2))
    yield row(
        f"{name}: last loss over first",
        value_error=float(last / first),
        value_tolerance=1.0 if is_best else None,
        is_finite=all(np.all(np.isfinite(a)) for a in jax.tree.leaves(list(found))),
    )
    for words, values in measures.items():
        yield row(
            f"{name}: {words}",
            value_error=float(np.median(values)),
            value_tolerance=BOUNDS[words] if is_best and plan == FULL else None,
        )


def descend(problem: Problem, recipe: Recipe) -> Errors:
    """Follow a recipe from the start."""

    def compute_loss(params, sigma):
        images = _render_views(*params, masses=problem.masses, sigma=sigma)
        return reprojection_loss(images, problem.targets)

    # Adam's own epsilon would hold light points still.
    adam = optax.scale_by_adam(b2=recipe.memory, eps=1e-30)

    def step(carry, inputs):
        sigma, *rates = inputs
        params, state = carry
        gradient = jax.grad(compute_loss)(params, sigma)
        scaled, state = adam.update(gradient, state)

        def move(param, rate, plain, scaled):
            return param - rate[:, None] * jnp.where(recipe.is_adam > 0, scaled, plain)

        return (jax.tree.map(move, params, tuple(rates), gradient, scaled), state), None

    def measure(params):
        sharp = _render_views(*params, masses=problem.masses, sigma=1.0)
        losses = jnp.sum((sharp - problem.targets) ** 2, axis=(1, 2))
        points, poses = params
        angles = jax.vmap(quaternion.angle_between)(poses, problem.poses)
        gaps = jnp.linalg.norm(points[:, None] - problem.surface[None], axis=-1)
        chamfer = 100 * (jnp.mean(jnp.min(gaps, 1)) + jnp.mean(jnp.min(gaps, 0)))
        return Errors(losses, jnp.degrees(angles), chamfer, jnp.diagonal(gaps))

    inputs = (recipe.sigmas, recipe.point_rates, recipe.pose_rates)
    begin = problem.start, adam.init(problem.start)
    (end, _), _ = jax.lax.scan(step, begin, inputs)
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), problem.start, end)
    return jax.lax.map(measure, both)


def _render_views(points, poses, *, masses, sigma) -> jax.Array:
    """Silhouettes [V, 32, 32] of points [N, 3] with masses [N] from poses [V, 4]."""
    looks = {"sigma": sigma, "scale": masses, "camera": Camera(), "grid": _GRID}
    return jax.lax.map(lambda q: project(points, q, **looks).silhouette, poses)


def _list_mass_recipes(plan) -> Iterator[tuple[str, Recipe]]:
    """Gradients over masses, Adam, and Adam on heavy points before light ones."""
    flat = np.ones((plan.steps, _FEW))
    # A point starts when the heavier ones have come to rest, with a decay of its own.
    begin = 0.6 * plan.steps * np.arange(_FEW) / _FEW
    done = (np.arange(plan.steps)[:, None] - begin) / (0.4 * plan.steps)
    staged = np.where(done < 0, 0, 0.5 * (1 + np.cos(np.pi * np.clip(done, 0, 1))))
    for name, rate, rates, memory in (
        ("gradient / mass", 1e-3, flat * 1e-3 / _SPREAD, _MEMORY),
        ("Adam", None, flat * _cool(plan)[:, None] * 0.003, _MEMORY),
        (STAGED, None, staged * 0.003, 0.9),
    ):
        recipe = _make_recipe(plan, (1.0, 1.0), rate)
        still = np.zeros((plan.steps, VIEWS))
        yield name, recipe._replace(point_rates=rates, pose_rates=still, memory=memory)


def _make_shape(scene, plan, seed) -> Problem:
    """Nearly sharp targets of a scene; points start in a ball."""
    scenes = make_scenes(num_points=_DENSE, num_sparse=64, seed=seed)
    (cloud,) = (s.points for s in scenes if s.name == scene)
    rng = np.random.default_rng(seed)
    poses, surface = _draw_poses(rng), jnp.asarray(cloud, jnp.float32)
    targets = _render_views(surface, poses, masses=jnp.full(_DENSE, 2.0), sigma=0.5)
    # The total mass does not depend on the number of points.
    masses = jnp.full(plan.points, 2400 / plan.points, jnp.float32)
    ball = draw_ball(rng, plan.points, radius=0.3)
    axes = rng.normal(size=(VIEWS, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turn = jax.vmap(quaternion.from_axis_angle, in_axes=(0, None))
    turns = turn(jnp.asarray(axes, jnp.float32), np.radians(OFF_DEG))
    turned = jax.vmap(quaternion.multiply)(turns, poses).at[0].set(poses[0])
    start = jnp.asarray(ball, jnp.float32), turned
    return Problem(targets, poses, surface[: plan.points], masses, start)


def _make_cloud(seed) -> Problem:
    """Points of masses far apart, displaced by 0.02."""
    rng = np.random.default_rng(seed)
    *_, cloud = make_scenes(num_points=64, num_sparse=_FEW, seed=seed)
    poses, masses = _draw_poses(rng), jnp.asarray(_SPREAD, jnp.float32)
    points = jnp.asarray(cloud.points, jnp.float32)
    targets = _render_views(points, poses, masses=masses, sigma=1.0)
    moved = points + jnp.asarray(rng.normal(size=points.shape) * 0.02, jnp.float32)
    return Problem(targets, poses, points, masses, (moved, poses))


def _make_recipe(plan, ends: tuple[float, float], rate) -> Recipe:
    """Gradient descent at a rate, or Adam; log sigma goes evenly between its ends."""
    factors = np.ones(plan.steps) if rate else _cool(plan)
    rates = ((rate or 0.01) * factors)[:, None]
    pose_rates = np.tile(rates, (1, VIEWS))
    pose_rates[:, 0] = 0  # the first pose is known and fixes the frame
    return Recipe(
        np.geomspace(*ends, plan.steps),
        np.tile(rates, (1, plan.points)),
        *(pose_rates, np.array(rate is None), np.array(_MEMORY)),
    )


def _cool(plan):
    """Cosine decay of the learning rate, [T]."""
    return 0.5 * (1 + np.cos(np.pi * np.arange(plan.steps) / plan.steps))


def _draw_poses(rng):
    poses = rng.normal(size=(VIEWS, 4)).astype(np.float32)
    return jnp.asarray(poses / np.linalg.norm(poses, axis=1, keepdims=True))


ROWS = {"descent": run}
