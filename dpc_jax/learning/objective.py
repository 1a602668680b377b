"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's loss."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.learning import schedules
from dpc_jax.learning.cameras import (
    anchor_cameras,
    flatten_views,
    place_camera,
    predict_cameras,
)
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.losses import sum_terms
from dpc_jax.learning.poses.source import ForwardPass, find_poses
from dpc_jax.learning.predictions import draw_framed, encode_views, predict_shapes
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.render import VoxelGrid, count_blocks


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
    views = batch["images"], batch["masks"]
    is_framed = False
    if recipe.train.framed_views:
        is_framed = draw_framed(keys, views[0].shape[1])
    features = encode_views(params, *views, network=network, is_framed=is_framed)
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
    if averages.room is not None and stage.max_blocks is not None:
        seen = {"rotation": poses.rotations, **cameras}
        room = _find_room(averages.room, shapes, seen, step, recipe, stage)
        averages = averages._replace(room=room)
    priors = shapes.find_priors(step, train=recipe.train)
    terms = priors | anchor | poses.terms | pulls | cost_terms
    metrics |= poses.metrics | parts | {n: term.value for n, term in terms.items()}
    return compared + sum_terms(terms), (metrics, averages)


def _find_room(room, shapes, views, step, recipe, stage):
    """Room for the blocks that a view of the batch touches, counted now and then.

    In the grid that the batch is rendered in, on all devices; of points of one size.
    """
    _, shared = shapes.list_scenes(stage.grid / recipe.render.grid)

    def count(inputs):
        points, view = inputs
        return count_blocks(
            points,
            view["rotation"],
            sigma=shared["sigma"],
            translation=view.get("translation"),
            camera=place_camera(recipe.camera, view),
            grid=VoxelGrid(stage.grid),
        )

    def count_all(points, views):
        return jnp.max(jax.lax.map(count, (points, flatten_views(views))))

    is_due = schedules.counts_blocks(step)
    points = jnp.repeat(shapes.find_places()[0], views["rotation"].shape[1], axis=0)
    seen = jax.lax.stop_gradient((points, views))
    touched = jax.lax.cond(
        is_due, count_all, lambda *_: jnp.zeros((), jnp.int32), *seen
    )
    touched = jax.lax.pmax(touched, AXIS)
    return jnp.where(is_due, schedules.fit_room(room, touched, stage.grid), room)
