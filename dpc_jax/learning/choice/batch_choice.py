"""The hindsight choice for all views of a batch, by that for one view."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras, list_own
from dpc_jax.learning.choice.hindsight import choose_in_scene, place_in_image
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.shapes.kind import Choice, Shape
from dpc_jax.learning.signals import SILHOUETTES, make_targets
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
    shapes: Shape,
    candidates: jax.Array,
    batch: Mapping[str, jax.Array],
    *,
    recipe: Recipe,
    cameras: Cameras = Cameras(),
) -> Winners:
    """Eq. 2 for all views of a batch, without gradient.

    Args:
      shapes: of B objects.
      candidates: [B·V, C, 4] quaternions.
      batch: masks uint8 [B, V, S, S] and, as the signals need them by which candidates
        are compared at full resolution, images and depths: see `make_targets`.
      cameras: [B, V, ...] of the views, where they have their own.
    """
    objects, per_object = batch["masks"].shape[:2]
    candidates = candidates.reshape(objects, per_object, -1, 4)
    if candidates.shape[2] == 1:
        indices = jnp.zeros((objects, per_object), jnp.int32)
        return Winners(candidates[:, :, 0], indices)

    how, render, camera = _find_choice(recipe), recipe.render, recipe.camera
    shapes, still, cameras = jax.lax.stop_gradient((shapes, candidates, cameras))
    kind = type(shapes)
    scene, shared = shapes.list_scenes()
    if "color" not in how.weights.signals:
        scene.pop("colors", None)
    scene = {n: jnp.repeat(a, per_object, axis=0) for n, a in scene.items()}
    total = objects * per_object
    flat = still.reshape(total, -1, 4)
    own = list_own(cameras, total)

    def place(scene, candidates, own):
        places = {"side": render.grid, "camera": camera, "how": how}
        return place_in_image(kind, scene | shared, candidates, own, **places)

    def choose(view):
        scene, *rest = view
        return choose_in_scene(kind, scene | shared, *rest, camera=camera, how=how)

    places = jax.vmap(place)(scene, flat, own)
    targets = downsample_images(batch["masks"], render.grid)
    own |= _list_others(batch, render, how.weights)
    targets = targets.reshape(total, *targets.shape[2:])
    indices = map_renders(
        choose,
        (scene, flat, targets, places, own),
        renders_at_once=render.renders_at_once,
    ).reshape(objects, per_object)
    poses = jnp.take_along_axis(candidates, indices[..., None, None], axis=2)[:, :, 0]
    return Winners(poses, indices)


def _find_choice(recipe):
    """How a run's candidates are compared; by all its signals where it asks for it."""
    pose, render = recipe.pose, recipe.render
    by_all = pose.choice_signals == "all"
    return Choice(
        pose.choice_points,
        pose.choice_top,
        render.renders_at_once,
        recipe.weights if by_all else SILHOUETTES,
        render.ray_rule,
    )


def _list_others(views, render, weights):
    """Targets of the signals besides silhouettes."""
    names = tuple(name for name in weights.signals if name != "silhouette")
    if not names:
        return {}
    targets = make_targets(views, render.grid, signals=names, distance=render.distance)
    return {"others": {n: a.reshape(-1, *a.shape[2:]) for n, a in targets.items()}}
