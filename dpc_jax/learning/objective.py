"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's loss."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.data.arrays import CORNERS
from dpc_jax.learning import schedules
from dpc_jax.learning.cameras import anchor_cameras, find_cameras
from dpc_jax.learning.framing import draw_framed, make_inputs
from dpc_jax.learning.poses.source import ForwardPass, find_poses
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.learning.shapes import find_shape_class


def compute_loss(
    params: Mapping,
    batch: dict[str, jax.Array],
    keys: jax.Array,
    step: jax.Array,
    averages: Averages,
    *,
    recipe: Recipe,
    stage: schedules.Stage,
) -> tuple[jax.Array, tuple[dict[str, jax.Array], Averages]]:
    """The training objective of one batch (§ Single-view Shape and Pose Estimation).

    The shape that is predicted from a view is compared with the next view of the same
    object, the last one's with the first. That view's pose is predicted from itself. To
    be called inside `jax.shard_map`, with a device's share of a batch of the run.

    Args:
      params: of the network. step: ().
      batch: images uint8 [B, V, S, S, 3], masks uint8 [B, V, S, S], quaternions
        [B, V, 4] (read where poses are given or labelled), what `list_extras` names,
        and corner_masks and corner_depths [B, 8, S, S] of maps.
      keys: [B], of each object. averages: of the batches before.
      recipe: what is learned, static. stage: of the schedule, static.

    Returns:
      (() loss, (metrics, averages)). Metrics: reprojection (mean sum of squares of a
      view), student's loss, scale, winners [B·V] int32, and the other active losses.
    """
    recipe = recipe.enter(stage)
    network, render = recipe.network, recipe.render
    sigma = schedules.compute_sigma(step, render, steps=recipe.train.steps)
    views = batch["masks"].shape[1]
    batch, keys = _flatten_views(batch, keys, views)
    is_framed = draw_framed(keys) if recipe.train.framed_views else False
    images = batch["images"], batch["masks"]
    inputs = make_inputs(*images, network=network, is_framed=is_framed)
    features: Any = network.apply(params, inputs, method="encode")
    of_objects = features.reshape(-1, views, features.shape[-1])
    before = jnp.roll(of_objects, 1, axis=1).reshape(features.shape)
    output: Any = network.apply(params, before, method="predict_shape")
    kind = find_shape_class(network.shape.kind)
    shapes = kind.read(output, sigma, render=render).drop(keys, stage.kept_points)
    predicted: Any = network.apply(params, features, method="predict_camera")
    cameras = find_cameras(predicted, batch, pose=recipe.pose)
    metrics = {"scale": jnp.mean(shapes.find_scale())}
    anchor = anchor_cameras(cameras, recipe=recipe)
    forward = ForwardPass(
        params, batch, views, features, shapes, cameras, keys, step, averages
    )
    poses = find_poses(forward, recipe=recipe)
    placed = {"rotation": poses.rotations, **cameras}
    compared, parts, costs = shapes.compare(placed, batch, recipe=recipe, stage=stage)
    pulls = shapes.find_pulls(placed, batch, step, recipe=recipe)
    averages, cost_terms = poses.find_cost_terms(costs)
    priors = shapes.find_priors(step, train=recipe.train)
    terms = priors | anchor | poses.terms | pulls | cost_terms
    metrics |= poses.metrics | parts | {n: term.value for n, term in terms.items()}
    total = jnp.zeros(())
    for term in terms.values():
        total = total + term.weight * term.value
    return compared + total, (metrics, averages)


def _flatten_views(batch, keys, views):
    """Arrays [B, V, ...] as [B·V, ...], each object's own for all its views; keys.

    What an object has of its own is the seed and the views from a cube's corners.
    """
    own = ("seeds", *CORNERS)
    flat = {n: a.reshape(-1, *a.shape[2:]) for n, a in batch.items() if n not in own}
    flat |= {n: jnp.repeat(batch[n], views, axis=0) for n in CORNERS if n in batch}
    split = jax.vmap(lambda key: jax.random.split(key, views))
    return flat, split(keys).reshape(-1)
