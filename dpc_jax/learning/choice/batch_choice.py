"""The hindsight choice for all views of a batch, by that for one view."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose, Render
from dpc_jax.learning.cameras import Cameras, list_own
from dpc_jax.learning.choice.hindsight import Choice, choose_in_scene, find_image_places
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.predictions import Cells, Shapes
from dpc_jax.learning.renders import make_scenes
from dpc_jax.learning.signals import SILHOUETTES, Weights, make_targets
from dpc_jax.render import Camera
from dpc_jax.render.batch import map_renders


class Winners(NamedTuple):
    """The candidates that explain the views of a batch best.

    Attributes:
      poses: [B, V, 4] quaternions.
      indices: [B, V] int32; candidate i belongs to head i % K.
    """

    poses: jax.Array
    indices: jax.Array


def choose_poses(
    shapes: Shapes | Cells,
    candidates: jax.Array,
    masks: jax.Array,
    *,
    camera: Camera,
    render: Render,
    pose: Pose,
    cameras: Cameras = Cameras(),
    views: Mapping[str, jax.Array] | None = None,
    weights: Weights = SILHOUETTES,
) -> Winners:
    """Eq. 2 for all views of a batch, without gradient.

    Args:
      shapes: of B objects.
      candidates: [B·V, C, 4] quaternions.
      masks: uint8 [B, V, S, S].
      camera: see `project`.
      render: the grid, and how many renders run side by side. pose: how candidates
        are compared.
      cameras: [B, V, ...] of the views, where they have their own.
      views: masks and, as the weights need them, images and depths: see `make_targets`.
      weights: of the signals by which candidates are compared at full resolution, if
        `pose.choice_signals` is "all"; the silhouette alone otherwise.
    """
    batch_size, per_object = masks.shape[:2]
    total = batch_size * per_object
    candidates = candidates.reshape(batch_size, per_object, -1, 4)
    if candidates.shape[2] == 1:
        indices = jnp.zeros((batch_size, per_object), jnp.int32)
        return Winners(candidates[:, :, 0], indices)

    if pose.choice_signals == "silhouette":
        weights = SILHOUETTES
    how = Choice(
        pose.choice_rank,
        pose.choice_grid,
        pose.choice_points,
        pose.choice_top,
        render.renders_at_once,
        weights,
        render.ray_rule,
    )
    shapes, still, cameras = jax.lax.stop_gradient((shapes, candidates, cameras))
    scene, shared = make_scenes(shapes)
    if "color" not in weights.signals:
        scene.pop("colors", None)
    scene = {n: jnp.repeat(a, per_object, axis=0) for n, a in scene.items()}
    flat = still.reshape(total, -1, 4)
    own = list_own(cameras, total)
    places = jax.vmap(
        lambda scene, candidates, own: find_image_places(
            scene | shared, candidates, own, side=render.grid, camera=camera, how=how
        )
    )(scene, flat, own)
    targets = downsample_images(masks, render.grid)
    own |= _list_others(views or {}, render, weights)
    targets = targets.reshape(total, *targets.shape[2:])

    def choose(view):
        scene, *rest = view
        return choose_in_scene(scene | shared, *rest, camera=camera, how=how)

    indices = map_renders(
        choose,
        (scene, flat, targets, places, own),
        renders_at_once=render.renders_at_once,
    ).reshape(batch_size, per_object)
    poses = jnp.take_along_axis(candidates, indices[..., None, None], axis=2)[:, :, 0]
    return Winners(poses, indices)


def _list_others(views, render, weights):
    """Targets of the signals besides silhouettes."""
    names = tuple(name for name in weights.signals if name != "silhouette")
    if not names:
        return {}
    targets = make_targets(views, render.grid, signals=names, distance=render.distance)
    return {"others": {n: a.reshape(-1, *a.shape[2:]) for n, a in targets.items()}}
