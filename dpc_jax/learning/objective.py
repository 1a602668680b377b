"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's loss."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.learning import schedules
from dpc_jax.learning.cameras import anchor_cameras, predict_cameras
from dpc_jax.learning.losses import sum_terms
from dpc_jax.learning.poses.source import ForwardPass, find_poses
from dpc_jax.learning.predictions import encode_views, predict_shapes
from dpc_jax.learning.recipe import Averages, Recipe


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

    The shape is predicted from each object's first view and compared with all its
    views. Each view's pose is predicted from that view itself. To be called inside
    `devices.share`, with a device's share of a batch of the run.

    Args:
      params: of the network. step: ().
      batch: images uint8 [B, V, S, S, 3], masks uint8 [B, V, S, S], quaternions
        [B, V, 4] (read where poses are given or labelled), what `list_extras` names,
        and corner_masks and corner_depths [B, 8, S, S] in stages of fixed views.
      keys: [B], of each object. averages: of the batches before.
      recipe: what is learned, static. stage: of the schedule, static.

    Returns:
      (() loss, (metrics, averages)). Metrics: reprojection (mean sum of
      squares of a view), student's loss, scale, winners [B·V] int32, and the other
      active losses.
    """
    network, render = recipe.network, recipe.render
    sigma = schedules.compute_sigma(step, render, steps=recipe.train.steps)
    features = encode_views(params, batch["images"], batch["masks"], network=network)
    shapes = predict_shapes(
        params,
        features[:, 0],
        keys,
        sigma,
        network=network,
        render=render,
        kept_points=stage.kept_points,
    )
    cameras = predict_cameras(
        params, features, batch, network=network, pose=recipe.pose
    )
    metrics = {"scale": jnp.mean(shapes.find_scale())}
    anchor = anchor_cameras(cameras, recipe=recipe)
    forward = ForwardPass(
        params, batch, features, shapes, cameras, keys, step, averages
    )
    poses = find_poses(forward, recipe=recipe)
    compared, parts, costs = shapes.compare(
        poses.rotations, batch, cameras, recipe=recipe, stage=stage
    )
    pulls = shapes.find_pulls(poses.rotations, batch, cameras, step, recipe=recipe)
    averages, cost_terms = poses.find_cost_terms(costs)
    room = shapes.find_room(
        averages.room, poses.rotations, cameras, step, recipe=recipe, stage=stage
    )
    priors = shapes.find_priors(step, train=recipe.train)
    terms = priors | anchor | poses.terms | pulls | cost_terms
    metrics |= poses.metrics | parts | {n: term.value for n, term in terms.items()}
    return compared + sum_terms(terms), (metrics, averages._replace(room=room))
