"""How well poses explain a view: by its silhouette, by its colours, as renders."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.choice.hindsight import RANKING_POINTS, compare_in_scene
from dpc_jax.learning.framing import (
    Frame,
    cut_silhouettes,
    fit_frame,
    frame_by_moments,
)
from dpc_jax.learning.shapes import find_shape_class
from dpc_jax.learning.shapes.kind import Choice, Scene, place_view
from dpc_jax.learning.signals import (
    downsample_images,
    find_background,
    spread_masks,
)
from dpc_jax.render import Camera, Projection
from dpc_jax.render.batch import map_renders


class Observation(NamedTuple):
    """What a view shows, at the side D of a grid.

    Attributes:
      target: [D, D] silhouette.
      camera: what the view's camera has of its own: translation [3], focal_length ().
      frame: of a target that was taken from any distance, by its moments: silhouettes
        are compared each in its own frame then. None: the camera is the run's.
    """

    target: Any
    camera: Mapping[str, Any]
    frame: Frame | None = None


def observe(
    masks: jax.Array,
    cameras: Mapping[str, jax.Array],
    side: int,
    *,
    config: Config,
    knows_distance: bool = True,
) -> Observation:
    """The observations of n views, averaged down to a grid of that side.

    Args:
      masks: uint8 [n, S, S].
      knows_distance: whether the cameras of the views are those of the run.
    """
    target = downsample_images(masks, side)
    target = spread_masks(target) if config.spreads_masks else target
    frame = None if knows_distance else frame_by_moments(target)
    return Observation(target, cameras, frame)


def compare_poses(
    scene: Scene, poses: jax.Array, observation: Observation, *, config: Config
) -> jax.Array:
    """Losses [n] of a shape seen from poses [n, 4]: squares of silhouettes, summed.

    Signals beside silhouettes are not compared: a user's image has no depth.

    Args:
      scene: of the shape, sizes in voxels of the observation's grid.
    """
    target, own, frame = observation
    side, at_once = target.shape[0], config.render.renders_at_once
    kind = find_shape_class(config.network.shape)
    if frame is None:
        view = place_view(poses, own, side, config.render)
        how = Choice(renders_at_once=at_once)
        return kind.compare_candidates(scene, view, {"silhouette": target}, how)
    framed = cut_silhouettes(target, frame)

    def compare(pose):
        view = place_view(pose, own, side, config.render)
        image = kind.render(scene, view, signals=("silhouette",)).silhouette
        assert image is not None
        found = fit_frame(frame_by_moments(image), image, framed)
        return jnp.sum((cut_silhouettes(image, found) - framed) ** 2)

    return map_renders(compare, poses, renders_at_once=at_once)


def rank_poses(
    scene: Scene, poses: jax.Array, observation: Observation, *, config: Config
) -> jax.Array:
    """Losses [n] as of `compare_poses`, coarse ones where the distance is known.

    Those of points with sizes of their own are exact, and take longer.
    """
    if observation.frame is not None:
        return compare_poses(scene, poses, observation, config=config)
    target, own, _ = observation
    how = Choice(RANKING_POINTS, 0, config.render.renders_at_once)
    view = place_view(poses, own, target.shape[0], config.render)
    kind = find_shape_class(config.network.shape)
    return compare_in_scene(kind, scene, view, {"silhouette": target}, how)


def find_color_scores(frame: Any, config: Config) -> jax.Array | None:
    """What colours are judged by, from a run's frame; None where it counts none."""
    if frame is None or config.pose.common_frame != "colors":
        return None
    from dpc_jax.learning.choice import colors  # where asked for

    return colors.score_colors(frame)


def weigh_by_colors(
    probabilities: jax.Array,
    scene: Scene,
    candidates: jax.Array,
    image: jax.Array,
    mask: jax.Array,
    base: Observation,
    *,
    scores: jax.Array,
    config: Config,
) -> jax.Array:
    """Probabilities [C] of the candidates [C, 4], by the colours of the view, too.

    Args:
      scene: of points. image: uint8 [S, S, 3]. mask: uint8 [S, S].
      scores: of `find_color_scores`.
    """
    from dpc_jax.learning.choice import colors  # where asked for

    camera = Camera(config.render.focal_length, config.render.distance)
    bins = colors.spread_colors(image, mask)

    def judge(pose):
        samples = colors.see_points(
            scene["points"][: colors.POINTS],
            {"rotation": pose, **base.camera},
            bins,
            mask,
            camera=camera,
            frame=base.frame,
        )
        return colors.judge_samples(colors.weigh_paint(samples), scores)

    misfits = -jax.vmap(judge)(candidates)
    return jax.nn.softmax(find_posteriors(misfits, probabilities))


def find_posteriors(losses: jax.Array, probabilities: jax.Array) -> jax.Array:
    """Logarithms [C] of candidates' posteriors, but for a constant.

    What the student thinks of an image is the prior, how a candidate's render fits the
    image the likelihood: P(c)·exp(-loss(c)), as of pixels with errors of variance 1/2.
    """
    tiny = jnp.finfo(probabilities.dtype).tiny
    return jnp.log(jnp.maximum(probabilities, tiny)) - losses


def render_finest(
    scene: Scene,
    pose: jax.Array,
    camera: Mapping[str, Any],
    *,
    signals: tuple[str, ...] = ("silhouette",),
    config: Config,
) -> Projection:
    """A shape in the finest grid, seen from a pose [4], as of `Shape.weigh_finest`.

    Args:
      scene: sizes in voxels of the base grid. camera: as `Observation.camera`.
    """
    render, kind = config.render, find_shape_class(config.network.shape)
    return kind.render(
        kind.weigh_finest(scene, render),
        place_view(pose, camera, render.finest, render),
        signals=signals,
        background_depth=find_background(render.distance),
    )
