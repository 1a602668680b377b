"""What a trained network makes of a view: how candidates fit it, and its images."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.renders import compute_candidate_losses
from dpc_jax.learning.shapes import Shape, find_kind
from dpc_jax.learning.shapes.kind import Scene, View
from dpc_jax.learning.signals import (
    SILHOUETTES,
    Weights,
    find_background,
    make_targets,
    read_weights,
)
from dpc_jax.render import Camera

FINALISTS = 4  # candidates of a view that are compared in the finest grid
_SOURCES = {"depth": "depths", "color": "images"}  # arrays that signals are read from


def kind_of(config: Config) -> type[Shape]:
    """What the run's shapes are."""
    return find_kind(config.network.shape)


def list_compared(
    views: Mapping[str, jax.Array], side: int, config: Config
) -> dict[str, Any]:
    """Targets of the signals besides silhouettes that candidates are compared by.

    Args:
      views: images, masks and what else there is of n views, by name.
      side: D of the grid.

    Returns:
      {"others": {signal: targets [n, ...]}}, or nothing.
    """
    if config.pose.choice_signals == "silhouette" or config.pose.heads < 2:
        return {}
    names = [name for name in read_weights(config.train).signals if name in _SOURCES]
    present = tuple(name for name in names if _SOURCES[name] in views)
    distance = config.render.distance
    return {"others": make_targets(views, side, signals=present, distance=distance)}


def find_posteriors(losses: jax.Array, probabilities: jax.Array) -> jax.Array:
    """Logarithms [C] of candidates' posteriors, but for a constant.

    What the student thinks of an image is the prior, how a candidate's render fits the
    image the likelihood: P(c)·exp(-loss(c)), as of pixels with errors of
    variance 1/2.

    Args:
      losses: [C] sums of squared differences. probabilities: [C] of the student.
    """
    tiny = jnp.finfo(probabilities.dtype).tiny
    return jnp.log(jnp.maximum(probabilities, tiny)) - losses


def rank_finely(
    scene: Scene,
    candidates: jax.Array,
    losses: jax.Array,
    probabilities: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
) -> jax.Array:
    """Indices [F] of the likeliest candidates, that of the largest posterior first.

    The `FINALISTS` of the base grid are compared in the finest one: poses and their
    mirror poses differ by little more than a pixel of the former. Each of its pixels
    counts, so that the image weighs more against the student's probabilities.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      candidates: [C, 4]. losses: [C] in the base grid. probabilities: [C].
      target: [D, D] silhouette, own: see `compare_poses`; of the finest grid.
    """
    ratio = config.render.finest / config.render.grid
    posteriors = find_posteriors(losses, probabilities)
    _, best = jax.lax.top_k(posteriors, min(FINALISTS, len(candidates)))
    if ratio == 1:
        return best
    finer = compare_candidates(
        kind_of(config).resize(scene, ratio),
        candidates[best],
        target,
        own,
        config=config,
    )
    posteriors = find_posteriors(finer, probabilities[best])
    return best[jnp.argsort(-posteriors)]


def show_view(
    shown: dict[str, jax.Array],
    pose: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
) -> dict[str, jax.Array]:
    """Images of a shape from a pose [4].

    Args:
      shown: scene of the shape, sizes in voxels of the base grid.
      own: what the view has of its own: translation [3], focal_length ().

    Returns:
      {"silhouettes", "depths", "color_images"} in the finest grid that training
      renders in; depths and colours where there are any.
    """
    render = config.render
    camera = place_camera(Camera(render.focal_length, render.distance), own)
    side = render.finest
    is_asked = {
        "silhouette": True,
        "depth": not config.data.images or bool(config.data.test_meshes),
        "color": "colors" in shown,
    }
    kind = kind_of(config)
    image = kind.render(
        kind.resize(shown, side / render.grid),
        View(pose, camera, side, own.get("translation"), render.ray_rule),
        signals=tuple(name for name, holds in is_asked.items() if holds),
        background_depth=find_background(camera.distance),
    )
    names = {"silhouettes": image.silhouette, "depths": image.depth}
    images = names | {"color_images": image.color}
    return {n: a for n, a in images.items() if a is not None}


def weigh_finest(scene: Scene, config: Config) -> Scene:
    """A scene for the finest grid, as dense as training renders last."""
    kind, render = kind_of(config), config.render
    return kind.resize(
        kind.weigh_as_trained(scene, render), render.finest / render.grid
    )


def compare_poses(
    scene: Scene,
    poses: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
    weights: Weights = SILHOUETTES,
) -> jax.Array:
    """Losses [n] of a shape seen from poses [n, 4], at full resolution.

    By default sums of squared differences of the silhouette; with weights also of the
    others that the view has.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      target: [D, D] silhouette.
      own: what the view has of its own: translation [3], focal_length (), others
        {signal: target}.
    """
    render = config.render
    return compute_candidate_losses(
        kind_of(config),
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


def compare_candidates(
    scene: Scene,
    candidates: jax.Array,
    target: jax.Array,
    own: dict[str, Any],
    *,
    config: Config,
) -> jax.Array:
    """Losses [C] of candidates [C, 4] by the signals that training chooses by.

    Of those, one that the data lack (the depths of own images) is left out. Arguments
    as of `compare_poses`.
    """
    others, weights = own.get("others", {}), SILHOUETTES
    if config.pose.choice_signals == "all":
        wanted = read_weights(config.train)._asdict()
        kept = {n: w for n, w in wanted.items() if n in others or n == "silhouette"}
        weights = Weights(**(dict.fromkeys(wanted, 0.0) | kept))
        weights = weights if weights.signals else SILHOUETTES
    return compare_poses(scene, candidates, target, own, config=config, weights=weights)
