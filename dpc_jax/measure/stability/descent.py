"""Descent on poses and points from silhouettes: one compiled loop for every recipe."""

import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.render import Camera, VoxelGrid, project, quaternion

GRID = VoxelGrid(32)
CAMERA = Camera()
_MOMENTUM = 0.9  # Adam's decay of the mean gradient, its authors' value


class Problem(NamedTuple):
    """Silhouettes of one object, the truth behind them, and where a descent starts."""

    targets: jax.Array  # [V, 32, 32] silhouettes
    poses: jax.Array  # [V, 4] true quaternions
    surface: jax.Array  # [M, 3] true points
    masses: jax.Array  # [N] of the points to find, in voxels
    start: tuple[jax.Array, jax.Array]  # points [N, 3] and poses [V, 4]


class Recipe(NamedTuple):
    """How to descend; all of it traced, so that one program serves every recipe."""

    sigmas: jax.Array  # [T] standard deviation of a point at each iteration, voxels
    point_rates: jax.Array  # [T, N] learning rate of each point, in object units
    pose_rates: jax.Array  # [T, V] learning rate of each pose, in units of a quaternion
    is_adam: jax.Array  # () whether to take Adam's direction instead of the gradient
    memory: jax.Array  # () Adam's decay of the mean square; its authors take 0.999


class Trace(NamedTuple):
    """Errors before each iteration, and after the last."""

    losses: jax.Array  # [T + 1, V] reprojection loss of each view at sigma one
    pose_errors: jax.Array  # [T + 1, V] degrees
    chamfer: jax.Array  # [T + 1] in the paper's units (×100)
    # [T + 1, N] of each point from its true place. They mean something only if there
    # are as many points as true points.
    distances: jax.Array
    end: tuple[jax.Array, jax.Array]  # the last points and poses


def render_views(
    points: jax.Array, poses: jax.Array, *, masses: jax.Array, sigma: chex.Numeric
) -> jax.Array:
    """Silhouettes [V, 32, 32] of points [N, 3] with masses [N] from poses [V, 4]."""

    looks = {"sigma": sigma, "scale": masses, "camera": CAMERA, "grid": GRID}
    return jax.lax.map(lambda q: project(points, q, **looks).silhouette, poses)


@functools.partial(jax.jit, static_argnames="every")
def descend(problem: Problem, recipe: Recipe, *, every: int) -> Trace:
    """Follow a recipe from the start; T is a multiple of `every`.

    The error is measured after every so many iterations, so the trace has
    T / every + 1 entries.
    """
    # One dtype for all: with x64 the rates would bring in NumPy's float64.
    start = problem.start
    dtype = start[0].dtype
    recipe = jax.tree.map(lambda a: a.astype(dtype), recipe)

    def compute_loss(params, sigma):
        images = render_views(*params, masses=problem.masses, sigma=sigma)
        return reprojection_loss(images, problem.targets)

    def step(carry, inputs):
        sigma, point_rates, pose_rates = inputs
        params, mean, square, count = carry
        gradient = jax.grad(compute_loss)(params, sigma)
        count = count + 1
        mean = _average(mean, gradient, _MOMENTUM)
        square = _average(square, jax.tree.map(jnp.square, gradient), recipe.memory)
        rates = point_rates[:, None], pose_rates[:, None]

        def move(param, rate, plain, m, s):
            m, s = m / (1 - _MOMENTUM**count), s / (1 - recipe.memory**count)
            # Adam without its epsilon, which would hold light points still.
            scaled = jnp.where(s == 0, 0, m / jnp.sqrt(jnp.where(s == 0, 1, s)))
            return param - rate * jnp.where(recipe.is_adam > 0, scaled, plain)

        params = jax.tree.map(move, params, rates, gradient, mean, square)
        return (params, mean, square, count), None

    def measure(params):
        sharp = render_views(*params, masses=problem.masses, sigma=1.0)
        losses = jnp.sum((sharp - problem.targets) ** 2, axis=(1, 2))
        points, poses = params
        angles = jax.vmap(quaternion.angle_between)(poses, problem.poses)
        gaps = jnp.linalg.norm(points[:, None] - problem.surface[None], axis=-1)
        chamfer = 100 * (jnp.mean(jnp.min(gaps, 1)) + jnp.mean(jnp.min(gaps, 0)))
        return losses, jnp.degrees(angles), chamfer, jnp.diagonal(gaps)

    def stretch(carry, inputs):
        errors = measure(carry[0])
        carry, _ = jax.lax.scan(step, carry, inputs)
        return carry, errors

    zeros = jax.tree.map(jnp.zeros_like, start)
    carry = (start, zeros, zeros, 0)
    inputs = jax.tree.map(
        lambda a: a.reshape(-1, every, *a.shape[1:]),
        (recipe.sigmas, recipe.point_rates, recipe.pose_rates),
    )
    carry, before = jax.lax.scan(stretch, carry, inputs)
    after = measure(carry[0])
    joined = jax.tree.map(lambda b, a: jnp.concatenate([b, a[None]]), before, after)
    return Trace(*joined, end=carry[0])


def _average(old, new, decay):
    return jax.tree.map(lambda a, b: decay * a + (1 - decay) * b, old, new)


def turn_randomly(
    poses: jax.Array, degrees: float, rng: np.random.Generator
) -> jax.Array:
    """Poses [V, 4] turned by an angle, each about a random axis."""
    axes = rng.normal(size=(len(poses), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turn = jax.vmap(quaternion.from_axis_angle, in_axes=(0, None))
    turns = turn(jnp.asarray(axes, jnp.float32), np.radians(degrees))
    return jnp.asarray(jax.vmap(quaternion.multiply)(turns, poses))
