"""Stiff optimisation: points and poses from six silhouettes of a thin object.

Points start in a ball, poses 30° off, and one known pose holds the frame. A point's
curvature grows with the square of its mass: with masses of 10⁴ : 1 the condition number
is about 10⁸.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import draw_ball, make_scenes
from dpc_jax.measure.stability.runner import QUICKLY, Row
from dpc_jax.render import VoxelGrid, project, quaternion

VIEWS = 6
OFF_DEG = 30.0  # of the first poses from the true ones
BEST = "Adam, σ 2 → 0.5"
# First and last sigma in voxels, rate of plain gradient descent, or None for Adam.
RECIPES = {
    "gradient, σ 1": ((1.0, 1.0), 4e-4),
    "Adam, σ 5": ((5.0, 5.0), None),
    "Adam, σ 1": ((1.0, 1.0), None),
    "Adam, σ 0.2": ((0.2, 0.2), None),
    BEST: ((2.0, 0.5), None),
}
LOSS, POSE = "last loss over first", "pose error (degrees)"
CHAMFER = "Chamfer distance (x100)"
# Errors that the best recipe may leave, medians over seeds. Descents are chaotic, and
# another processor rounds differently: a fifth above the worst single seed measured
# (6.7°, 7.8; they start at 30° and 12 to 15).
BOUNDS = {LOSS: 1.0, POSE: 8.0, CHAMFER: 9.5}
_DENSE = 2000  # points that targets are rendered from


class Plan(NamedTuple):
    """How much is run."""

    steps: int  # iterations
    points: int  # to find
    seeds: int  # of views, starts and surfaces
    problems: tuple[tuple[str, float], ...]  # object, heaviest mass over the lightest
    bounds: dict[str, float]  # that the best recipe is held to


_STIFF = ("chair", 1e4)
FULL = Plan(400, 600, 3, (("car", 1.0), ("chair", 1.0), _STIFF), BOUNDS)
# In so few iterations the loss falls, and that is all.
QUICK = Plan(40, 24, 1, (_STIFF,), {LOSS: BOUNDS[LOSS]})


class Problem(NamedTuple):
    """Silhouettes of one object, the truth behind them, and where a descent starts."""

    targets: jax.Array  # [V, 32, 32] silhouettes
    poses: jax.Array  # [V, 4] true quaternions
    surface: jax.Array  # [N, 3] true points
    masses: jax.Array  # [N] of the points to find, voxels
    start: tuple[jax.Array, jax.Array]  # points [N, 3] and poses [V, 4]


def run(*, quick: bool) -> Iterator[Row]:
    """Rows of all descents of the plan: all stay finite, the best recipe arrives."""
    plan, options = (QUICK, QUICKLY) if quick else (FULL, None)
    program = jax.jit(descend, compiler_options=options, static_argnames="rate")
    for name, ratio in plan.problems:
        seeds = range(plan.seeds)
        problems = [_make_problem(name, ratio, plan, seed) for seed in seeds]
        title = name if ratio == 1 else f"{name}, masses {ratio:.0f} : 1"
        for words, ((begin, end), rate) in RECIPES.items():
            # log sigma goes evenly between its ends.
            sigmas = jnp.asarray(np.geomspace(begin, end, plan.steps), jnp.float32)
            found = [jax.device_get(program(p, sigmas, rate=rate)) for p in problems]
            medians = {key: np.median([e[key] for e in found]) for key in BOUNDS}
            limits = plan.bounds if words == BEST else {}
            errors = {k: (float(m), limits.get(k, np.inf)) for k, m in medians.items()}
            yield Row("descent", f"{title}, {words}", "float32", errors)


def descend(problem: Problem, sigmas: jax.Array, *, rate: float | None) -> dict:
    """Follow a recipe from the start; its errors by name.

    Args:
      sigmas: [T] standard deviation of a point at each iteration, voxels.
      rate: of gradient descent, in object units and units of a quaternion; None for
        Adam, whose rate decays by a cosine.
    """
    decay = optax.cosine_decay_schedule(0.01, len(sigmas))
    optimizer = optax.sgd(rate) if rate else optax.adam(decay)

    def compute_loss(params, sigma):
        images = _render_views(*params, masses=problem.masses, sigma=sigma)
        return reprojection_loss(images, problem.targets)

    def step(carry, sigma):
        params, state = carry
        points, poses = jax.grad(compute_loss)(params, sigma)
        # The first pose is known and fixes the frame.
        updates, state = optimizer.update((points, poses.at[0].set(0)), state)
        return (optax.apply_updates(params, updates), state), None

    begin: Any = problem.start, optimizer.init(problem.start)
    end: Any = jax.lax.scan(step, begin, sigmas)[0][0]
    points, poses = end
    angles = jax.vmap(quaternion.angle_between)(poses, problem.poses)
    gaps = jnp.linalg.norm(points[:, None] - problem.surface[None], axis=-1)
    first, last = (compute_loss(p, 1.0) for p in (problem.start, end))
    return {
        LOSS: last / first,
        POSE: jnp.median(jnp.degrees(angles[1:])),
        CHAMFER: 100 * (jnp.mean(jnp.min(gaps, 1)) + jnp.mean(jnp.min(gaps, 0))),
    }


def _render_views(points, poses, *, masses, sigma) -> jax.Array:
    """Silhouettes [V, 32, 32] of points [N, 3] with masses [N] from poses [V, 4]."""
    looks = {"sigma": sigma, "scale": masses, "grid": VoxelGrid(32)}
    return jax.lax.map(lambda q: project(points, q, **looks).silhouette, poses)


def _make_problem(name, ratio, plan, seed) -> Problem:
    """Nearly sharp targets of an object; points start in a ball."""
    scenes = make_scenes(num_points=_DENSE, num_sparse=64, seed=seed)
    (cloud,) = (s.points for s in scenes if s.name == name)
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(VIEWS, 4)).astype(np.float32)
    poses = jnp.asarray(poses / np.linalg.norm(poses, axis=1, keepdims=True))
    surface = jnp.asarray(cloud, jnp.float32)
    targets = _render_views(surface, poses, masses=2.0, sigma=0.5)
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
