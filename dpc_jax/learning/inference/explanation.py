"""What a trained network makes of a view: its images, and the best candidate."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.renders import (
    compute_candidate_losses,
    render_scene,
    resize_scene,
)
from dpc_jax.learning.signals import (
    SILHOUETTES,
    Weights,
    find_background,
    make_targets,
    read_weights,
)
from dpc_jax.render import Camera

_SOURCES = {"depth": "depths", "color": "images"}  # arrays that signals are read from


def list_compared(views: Mapping[str, jax.Array], config: Config) -> dict[str, Any]:
    """Targets of the signals besides silhouettes that candidates are compared by.

    Args:
      views: images, masks and what else there is of n views, by name.

    Returns:
      {"others": {signal: targets [n, ...]}}, or nothing.
    """
    if config.pose.choice_signals == "silhouette" or config.pose.heads < 2:
        return {}
    names = [name for name in read_weights(config.train).signals if name in _SOURCES]
    present = tuple(name for name in names if _SOURCES[name] in views)
    grid, distance = config.render.grid, config.render.distance
    return {"others": make_targets(views, grid, signals=present, distance=distance)}


def explain_view(
    scene: dict[str, jax.Array],
    student: jax.Array,
    candidates: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    shown: dict[str, jax.Array],
    config: Config,
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Images of a shape from the student's pose, and the best candidate's index.

    The best candidate is that of the exact comparison, by the signals that the choice
    in training compares; of those, one that the data lack (the depths of own images) is
    left out.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      student: [4]. candidates: [C, 4]. target: [D, D] silhouette.
      own: what the view has of its own: translation [3], focal_length (), others
        {signal: target}.
      shown: the scene of the images, where its sizes are not those of the comparison.

    Returns:
      ({"silhouettes", "depths", "color_images"} in the finest grid that training
      renders in; depths and colours where there are any; ()).
    """
    render = config.render
    camera = place_camera(Camera(render.focal_length, render.distance), own)
    side = render.fine_grid or render.grid
    is_asked = {
        "silhouette": True,
        "depth": not config.data.images or bool(config.data.test_meshes),
        "color": "colors" in shown,
    }
    image = render_scene(
        resize_scene(shown, side / render.grid),
        student,
        translation=own.get("translation"),
        camera=camera,
        side=side,
        signals=tuple(name for name, holds in is_asked.items() if holds),
        ray_rule=render.ray_rule,
        background_depth=find_background(camera.distance),
    )
    names = {"silhouettes": image.silhouette, "depths": image.depth}
    images = names | {"color_images": image.color}
    winner = jnp.zeros((), jnp.int32)
    if len(candidates) > 1:
        winner = _choose_exactly(scene, candidates, target, own, config)
    return {n: a for n, a in images.items() if a is not None}, winner


def compare_poses(
    scene: dict[str, jax.Array],
    poses: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
    weights: Weights = SILHOUETTES,
) -> jax.Array:
    """Losses [n] of a shape seen from poses [n, 4], at full resolution.

    Arguments as of `explain_view`. By default sums of squared differences of the
    silhouette; with weights also of the others that the view has.
    """
    render = config.render
    return compute_candidate_losses(
        scene,
        poses,
        target,
        camera=place_camera(Camera(render.focal_length, render.distance), own),
        renders_at_once=render.renders_at_once,
        translation=own.get("translation"),
        others=own.get("others"),
        weights=weights,
        ray_rule=render.ray_rule,
    )


def _choose_exactly(scene, candidates, target, own, config):
    """Index of the candidate of the smallest loss at full resolution; ()."""
    others, weights = own.get("others", {}), SILHOUETTES
    if config.pose.choice_signals == "all":
        wanted = read_weights(config.train)._asdict()
        kept = {n: w for n, w in wanted.items() if n in others or n == "silhouette"}
        weights = Weights(**(dict.fromkeys(wanted, 0.0) | kept))
        weights = weights if weights.signals else SILHOUETTES
    losses = compare_poses(
        scene, candidates, target, own, config=config, weights=weights
    )
    return jnp.argmin(losses)
