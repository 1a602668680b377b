"""Eq. 1 for the winners of the choice: each rendered with its gradient, and compared.

A view's gradient is computed right after its render, while the volume is in the
processor's cache. So no volume is kept for a backward pass over the batch.
"""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras, list_own, place_camera
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes.kind import Shape, View
from dpc_jax.learning.signals import Weights, make_targets
from dpc_jax.render import Camera
from dpc_jax.render.batch import map_renders


class _Static(NamedTuple):
    """What is static about a comparison."""

    kind: type[Shape]
    camera: tuple[float, float]  # focal length and distance
    grid: int
    weights: Weights
    renders_at_once: int
    ray_rule: str
    colors_move_points: bool


def compare_winners(
    shapes: Shape,
    rotations: jax.Array,
    batch: Mapping[str, jax.Array],
    *,
    recipe: Recipe,
    stage: Stage,
    cameras: Cameras = Cameras(),
) -> tuple[jax.Array, dict[str, jax.Array], jax.Array]:
    """Eq. 1: differences of rendered images and views, averaged over the views.

    The sum of a finer image is divided by its pixels per pixel of the base grid, so
    that losses are comparable over the whole run.

    Args:
      shapes: of B objects.
      rotations: [B, V, 4] quaternions, the pose of each view.
      batch: masks uint8 [B, V, S, S], images uint8 [B, V, S, S, 3] and depths
        [B, V, S, S]: what the signals that have a weight need.
      recipe: has the base grid, the camera and the weights of the signals. stage: the
        grid of the winners.
      cameras: [B, V, ...] of the views, where they have their own.

    Returns:
      (() the weighted sum, which has the gradient; {name: ()} of its terms; [B·V] what
      each view has of the sum, without gradient).
    """
    render, train, weights = recipe.render, recipe.train, recipe.weights
    num_views = rotations.shape[0] * rotations.shape[1]
    ratio = stage.grid / render.grid
    scene, shared = shapes.list_scenes(ratio)
    learned = jax.tree.map(
        lambda array: jnp.repeat(array, rotations.shape[1], axis=0), scene
    ) | {"rotation": rotations.reshape(-1, 4)}
    learned |= list_own(cameras, num_views)
    targets = make_targets(
        batch, stage.grid, signals=weights.signals, distance=render.distance
    )
    given = {
        "targets": jax.tree.map(lambda a: a.reshape(num_views, *a.shape[2:]), targets),
    }
    for name, value in shared.items():
        given[name] = jnp.broadcast_to(jax.lax.stop_gradient(value), num_views)
    static = _Static(
        type(shapes),
        (render.focal_length, render.distance),
        stage.grid,
        weights,
        render.renders_at_once,
        render.ray_rule,
        train.colors_move_points,
    )
    result: Any = _sum_views(static, learned, given)
    total, terms, costs = result
    share = 1 / num_views / ratio**2
    terms = jax.tree.map(lambda value: value * share, terms)
    return total * share, terms, costs / ratio**2


def _compare_view(static, learned, given):
    """The weighted sum of a view's losses, and each of them."""
    scene = given | learned
    view = View(
        scene["rotation"],
        place_camera(Camera(*static.camera), scene),
        static.grid,
        scene.get("translation"),
        static.ray_rule,
    )
    return static.kind.compare_view(
        scene,
        view,
        given["targets"],
        weights=static.weights,
        colors_move_shapes=static.colors_move_points,
    )


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _sum_views(static: _Static, learned: dict[str, Any], given: dict[str, Any]) -> Any:
    """Σ over views of `_compare_view`, and its first result of each view.

    The gradient is that of the first sum.
    """
    call = functools.partial(_compare_view, static)
    costs, terms = map_renders(
        lambda view: call(*view),
        (learned, given),
        renders_at_once=static.renders_at_once,
    )
    return _sum_entries(costs, terms)


def _sum_entries(costs: jax.Array, terms: Any) -> Any:
    return jnp.sum(costs), jax.tree.map(jnp.sum, terms), costs


def _sum_views_forward(static, learned, given):
    call = jax.value_and_grad(functools.partial(_compare_view, static), has_aux=True)
    result, gradient = map_renders(
        lambda view: call(*view),
        (learned, given),
        renders_at_once=static.renders_at_once,
    )
    return _sum_entries(*result), gradient


def _sum_views_backward(static, gradient, cotangent):
    total = cotangent[0]
    return jax.tree.map(lambda part: total * part, gradient), None


_sum_views.defvjp(_sum_views_forward, _sum_views_backward)
