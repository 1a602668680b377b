"""Eq. 1 for the winners of the choice: each rendered with its gradient, and compared.

A view's gradient is computed right after its render, while the volume is in the
processor's cache. So no volume is kept for a backward pass over the batch.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Render, Train
from dpc_jax.learning import losses, point_sizes
from dpc_jax.learning.predictions import Shapes
from dpc_jax.learning.schedules import Stage
from dpc_jax.render import Camera, VoxelGrid, project
from dpc_jax.render.batch import map_renders


class _Static(NamedTuple):
    """What is static about a comparison."""

    focal_length: float
    distance: float
    grid: int
    color_weight: float
    renders_at_once: int


def compare_winners(
    shapes: Shapes,
    rotations: jax.Array,
    batch: dict[str, jax.Array],
    *,
    render: Render,
    train: Train,
    stage: Stage,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Eq. 1: squared differences of rendered images and views, averaged over the views.

    The sum of a finer image is divided by its pixels per pixel of the base grid, so
    that losses are comparable over the whole run.

    Args:
      shapes: of B objects.
      rotations: [B, V, 4] quaternions, the pose of each view.
      batch: images uint8 [B, V, S, S, 3] (read only where shapes have colours) and
        masks uint8 [B, V, S, S].
      render, train: the base grid, the camera and the weight of colours. stage: the
        grid of the winners.

    Returns:
      (() the weighted sum, which has the gradient; {name: ()} of its terms).
    """
    num_views = rotations.shape[0] * rotations.shape[1]
    ratio = stage.grid / render.grid
    sigma, mass = point_sizes.scale_point_sizes(shapes.sigma, shapes.mass, ratio)
    has_sizes = point_sizes.has_own_sizes(sigma)
    own = {"sigma": sigma} if has_sizes else {}
    learned = jax.tree.map(
        lambda array: jnp.repeat(array, rotations.shape[1], axis=0),
        {"points": shapes.kept, "mass": mass, "colors": shapes.colors} | own,
    ) | {"rotation": rotations.reshape(-1, 4)}
    given = {
        "mask": losses.downsample_images(batch["masks"], stage.grid),
    }
    if not has_sizes:
        given["sigma"] = jnp.broadcast_to(jax.lax.stop_gradient(sigma), num_views)
    if shapes.colors is not None:
        channels = jnp.moveaxis(batch["images"], -1, 2)
        targets = losses.downsample_images(channels, stage.grid)
        given["image"] = jnp.moveaxis(targets, 2, -1)
    for name in given.keys() & {"mask", "image"}:
        given[name] = given[name].reshape(num_views, *given[name].shape[2:])
    static = _Static(
        render.focal_length,
        render.distance,
        stage.grid,
        train.color_weight,
        render.renders_at_once,
    )
    result: Any = _sum_views(static, learned, given)
    total, terms = result
    share = 1 / num_views / ratio**2
    return total * share, jax.tree.map(lambda value: value * share, terms)


def _compare_view(static, learned, given):
    """The weighted sum of a view's losses, and each of them."""
    colors = learned["colors"]
    sigma, covariance = point_sizes.split_size((given | learned)["sigma"])
    image = project(
        learned["points"],
        learned["rotation"],
        sigma=sigma,
        covariance=covariance,
        scale=learned["mass"],
        colors=colors,
        camera=Camera(static.focal_length, static.distance),
        grid=VoxelGrid(static.grid),
        signals=("silhouette",) if colors is None else ("silhouette", "color"),
    )
    assert image.silhouette is not None
    terms = {"reprojection": losses.reprojection_loss(image.silhouette, given["mask"])}
    total = terms["reprojection"]
    if image.color is not None:
        terms["color"] = losses.reprojection_loss(image.color, given["image"])
        total = total + static.color_weight * terms["color"]
    return total, terms


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _sum_views(static: _Static, learned: dict[str, Any], given: dict[str, Any]) -> Any:
    """Σ over views of `_compare_view`; its gradient is that of the first result."""
    call = functools.partial(_compare_view, static)
    return _sum_entries(
        map_renders(
            lambda view: call(*view),
            (learned, given),
            renders_at_once=static.renders_at_once,
        )
    )


def _sum_entries(tree: Any) -> Any:
    return jax.tree.map(jnp.sum, tree)


def _sum_views_forward(static, learned, given):
    call = jax.value_and_grad(functools.partial(_compare_view, static), has_aux=True)
    result, gradient = map_renders(
        lambda view: call(*view),
        (learned, given),
        renders_at_once=static.renders_at_once,
    )
    return _sum_entries(result), gradient


def _sum_views_backward(static, gradient, cotangent):
    total, _ = cotangent
    return jax.tree.map(lambda part: total * part, gradient), None


_sum_views.defvjp(_sum_views_forward, _sum_views_backward)
