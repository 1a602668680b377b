"""Which poses of a view are worth a fit: those that are likeliest for its shape."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.inference.explanation import compare_candidates, rank_finely
from dpc_jax.learning.inference.viewpoint_search import search_nearby
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.renders import Scene
from dpc_jax.render.batch import map_renders


class Evidence(NamedTuple):
    """What n objects of V views are fitted to.

    Attributes:
      codes: [n, F] to begin with, with tints [n, F + 3]. poses: [n, V, 4].
      candidates: [n, V, C, 4].
      probabilities: [n, V, C] that the student gives to candidates.
      masks: uint8 [n, V, S, S]. weights: [n, V] of views; 0 for one that fills up.
      own: of views' cameras, translation [n, V, 3] and focal_length [n, V] by name.
    """

    codes: Any
    poses: Any
    candidates: Any
    probabilities: Any
    masks: Any
    weights: Any
    own: dict[str, Any]


def rank_poses(
    scenes: Scene, shared: Scene, evidence: Evidence, config: Config, *, count: int
) -> jax.Array:
    """Of each view, the poses [n, V, F, 4] that its object's shape fits best.

    By silhouettes: other signals are not at hand. Where predictions are posteriors so
    are these. Else the student's pose is among the candidates, and counts as any. A
    single one is searched for nearby as predictions are; of several, a fit has to
    find out which is right, and moves them anyway.

    Args:
      scenes, shared: of n objects' shapes.
      count: F, how many; fewer where there are fewer candidates or `FINALISTS`.
    """
    render = config.render
    candidates, probabilities = evidence.candidates, evidence.probabilities
    if not config.pose.weighs_fit:
        candidates = jnp.concatenate([evidence.poses[:, :, None], candidates], axis=2)
        probabilities = jnp.ones(candidates.shape[:-1])
    targets = downsample_images(evidence.masks, render.grid)
    fine_targets = downsample_images(evidence.masks, render.finest)

    def rank(entry):
        scene, *views = entry
        return map_renders(
            functools.partial(rank_view, {**scene, **shared}),
            tuple(views),
            renders_at_once=render.renders_at_once,
        )

    def rank_view(scene, view):
        poses, probabilities, target, fine_target, own = view
        losses = compare_candidates(scene, poses, target, own, config=config)
        likeliest = rank_finely(
            scene, poses, losses, probabilities, fine_target, own, config=config
        )
        if count == 1 and config.pose.searches:
            best = poses[likeliest[0]]
            return search_nearby(scene, best, fine_target, own, config=config)[None]
        return poses[likeliest[:count]]

    return map_renders(
        rank,
        (scenes, candidates, probabilities, targets, fine_targets, evidence.own),
        renders_at_once=render.renders_at_once,
    )


def list_hypotheses(evidence: Evidence, likeliest: jax.Array) -> Evidence:
    """Each object F times, with one of the likeliest poses [n, V, F, 4] each."""
    count = likeliest.shape[2]
    if count == 1:
        return evidence._replace(poses=likeliest[:, :, 0])
    repeated = jax.tree.map(lambda array: jnp.repeat(array, count, axis=0), evidence)
    poses = jnp.swapaxes(likeliest, 1, 2)  # as many objects of V views
    return repeated._replace(poses=poses.reshape(-1, *poses.shape[2:]))


def take_best(costs: jax.Array, result: Any) -> Any:
    """Of the arrays [n·H, ...] those of the least of the costs [n, H]."""
    rows = jnp.arange(len(costs)) * costs.shape[1] + jnp.argmin(costs, axis=1)
    return jax.tree.map(lambda array: array[rows], result)
