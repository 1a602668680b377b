"""Predicted viewpoints, moved by degrees to where the image fits better.

A head says a viewpoint by features of the whole image, a few degrees off; outlines in
the finest grid tell single degrees. Not in the paper.
"""

from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.inference.explanation import compare_candidates, weigh_finest
from dpc_jax.learning.shapes.kind import Scene
from dpc_jax.networks.viewpoints import read_elevations
from dpc_jax.render import quaternion

STEPS = (4.0, 2.8, 2.0)  # degrees, one after the other
_SLACK = 1e-3  # radians that an elevation may lie beyond its range by rounding


def search_nearby(
    scene: Scene,
    pose: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
) -> jax.Array:
    """The viewpoint [4] near a predicted one that explains the image best.

    A pattern search: of the four viewpoints a step of azimuth or elevation away, the
    best one is taken if it is better, in the finest grid and by the signals that
    candidates are compared by; then the step is smaller. Elevations stay in the range
    of the heads. Points weigh as in training.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      pose: [4] quaternion of an upright camera.
      target: [D, D] silhouette, own: see `compare_poses`; of the finest grid.
    """
    finer = weigh_finest(scene, config)
    limits = config.pose.elevation_low, config.pose.elevation_high
    low, high = (jnp.deg2rad(angle) for angle in limits)

    def measure(poses):
        costs = compare_candidates(finer, poses, target, own, config=config)
        elevations = read_elevations(poses)
        is_allowed = (elevations >= low - _SLACK) & (elevations <= high + _SLACK)
        return jnp.where(is_allowed, costs, jnp.inf)

    def take_step(found, step):
        pose, cost = found
        neighbours = _list_neighbours(pose, step)
        costs = measure(neighbours)
        best = jnp.argmin(costs)
        is_better = costs[best] < cost
        pose = jnp.where(is_better, neighbours[best], pose)
        return (pose, jnp.where(is_better, costs[best], cost)), None

    start = compare_candidates(finer, pose[None], target, own, config=config)[0]
    steps = jnp.deg2rad(jnp.asarray(STEPS, pose.dtype))
    (pose, _), _ = jax.lax.scan(take_step, (pose, start), steps)
    return pose


def _list_neighbours(pose, step):
    """The viewpoints [4, 4] a step (radians) of azimuth or elevation away."""
    halves = jnp.stack([step, -step]) / 2
    cos, sin, zero = jnp.cos(halves), jnp.sin(halves), jnp.zeros(2, pose.dtype)
    about_up = jnp.stack([cos, zero, zero, sin], axis=-1)  # the object's z
    about_side = jnp.stack([cos, sin, zero, zero], axis=-1)  # the camera's x
    multiply = quaternion.multiply
    return jnp.concatenate(
        [
            jax.vmap(lambda turn: multiply(pose, turn))(about_up),
            jax.vmap(lambda turn: multiply(turn, pose))(about_side),
        ]
    )
