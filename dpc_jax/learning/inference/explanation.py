"""How well poses explain a view: which candidates are likeliest, and what is near."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.choice.hindsight import compare_in_scene
from dpc_jax.learning.framing import (
    Frame,
    cut_silhouettes,
    fit_frame,
    frame_by_moments,
)
from dpc_jax.learning.shapes import find_shape_class
from dpc_jax.learning.shapes.kind import Choice, Scene, View, place_view
from dpc_jax.learning.signals import (
    downsample_images,
    find_background,
    spread_masks,
)
from dpc_jax.networks.viewpoints import face_object, read_elevations
from dpc_jax.render import Camera, Projection, quaternion
from dpc_jax.render.batch import map_renders

FINALISTS = 3  # poses of a view that are compared in the finest grid
APART = 20.0  # degrees between any two of them
AZIMUTHS, ELEVATIONS = 24, 3  # of a grid of viewpoints
UNSEEN = 0.01  # probability of each, beside those of the candidates
ROUNDS, REACH = 3, 4.0  # of the search nearby; degrees that a round may move


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


def _place_view(rotation, per_view, side: int, config: Config) -> View:
    """A view of the run's shapes; see `place_view`."""
    camera = Camera(config.render.focal_length, config.render.distance)
    rule = config.render.ray_rule
    return place_view(rotation, per_view, side, camera, ray_rule=rule)


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
        view = _place_view(poses, own, side, config)
        targets = {"silhouette": target}
        return kind.compare_candidates(scene, view, targets, renders_at_once=at_once)
    framed = cut_silhouettes(target, frame)

    def compare(pose):
        view = _place_view(pose, own, side, config)
        image = kind.render(scene, view, signals=("silhouette",)).silhouette
        assert image is not None
        found = fit_frame(frame_by_moments(image), image, framed)
        return jnp.sum((cut_silhouettes(image, found) - framed) ** 2)

    return map_renders(compare, poses, renders_at_once=at_once)


def find_color_scores(frame: Any) -> jax.Array | None:
    """What colours are judged by, from a run's frame; None where it counts none."""
    if frame is None or frame.colors is None:
        return None
    from dpc_jax.learning.choice import common_frame  # where it is asked for

    return common_frame.score_clear_colors(frame)


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

    def judge(pose):
        samples = colors.see_points(
            scene["points"][: colors.POINTS],
            {"rotation": pose, **base.camera},
            image,
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


def add_viewpoints(
    scene: Scene,
    candidates: jax.Array,
    probabilities: jax.Array,
    base: Observation,
    *,
    config: Config,
) -> tuple[jax.Array, jax.Array]:
    """Candidates [C + V, 4] and probabilities, V of them viewpoints of no head.

    Heads that all turn a kind of objects round, or mirror it, offer no pose that is
    right; the silhouette still tells it. The V best of a grid of viewpoints stand
    beside the candidates, each as likely as one to which the student gives `UNSEEN`.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      candidates: [C, 4]. probabilities: [C].
      base: what the view shows in the base grid.
    """
    limits = config.pose.elevation_low, config.pose.elevation_high
    low, high = (jnp.deg2rad(angle) for angle in limits)
    azimuths = 2 * jnp.pi * jnp.arange(AZIMUTHS) / AZIMUTHS
    shares = (jnp.arange(ELEVATIONS) + 0.5) / ELEVATIONS
    views = face_object(*jnp.meshgrid(azimuths, low + (high - low) * shares))
    views = views.reshape(-1, 4).astype(candidates.dtype)
    losses = _rank_poses(scene, views, base, config)
    views = views[_find_peaks(views, -losses, FINALISTS)]
    chances = jnp.full(FINALISTS, UNSEEN, probabilities.dtype)
    joined = jnp.concatenate([probabilities, chances])
    return jnp.concatenate([candidates, views]), joined / jnp.sum(joined)


def _rank_poses(scene, poses, base, config):
    """Losses [n] of poses [n, 4], coarse ones where the view's distance is known."""
    if base.frame is not None:
        return compare_poses(scene, poses, base, config=config)
    how = Choice(config.pose.choice_points, 0, config.render.renders_at_once)
    view = _place_view(poses, base.camera, base.target.shape[0], config)
    kind = find_shape_class(config.network.shape)
    # Else XLA projects each point again for every pixel.
    places = jax.lax.optimization_barrier(kind.place_in_image(scene, view, how))
    targets = {"silhouette": base.target}
    return compare_in_scene(kind, scene, view, targets, places, how)


def find_likeliest(
    scene: Scene,
    candidates: jax.Array,
    losses: jax.Array,
    probabilities: jax.Array,
    fine: Observation,
    *,
    count: int,
    config: Config,
) -> jax.Array:
    """The poses [count, 4] of the largest posteriors, the likeliest first.

    The best `FINALISTS` of the base grid that are no neighbours of each other are
    compared in the finest one: poses and their mirror poses differ by little more than
    a pixel of the former. Viewpoints are first searched for nearby, since a few degrees
    cost more than what tells one side from another. Each pixel of the finest grid
    counts, so that the image weighs more there against the student's probabilities.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      candidates: [C, 4]. losses: [C] in the base grid. probabilities: [C].
      fine: what the view shows in the finest grid.
      count: how many; fewer where there are fewer candidates or `FINALISTS`.
    """
    posteriors = find_posteriors(losses, probabilities)
    best = _find_peaks(candidates, posteriors, min(FINALISTS, len(candidates)))
    poses = candidates[best]
    if config.pose.elevations:
        poses, losses = jax.lax.map(
            lambda pose: search_nearby(scene, pose, fine, config=config), poses
        )
    else:
        finest = weigh_finest(scene, config)
        losses = compare_poses(finest, poses, fine, config=config)
    posteriors = find_posteriors(losses, probabilities[best])
    return poses[jnp.argsort(-posteriors)[:count]]


def _find_peaks(poses: jax.Array, posteriors: jax.Array, count: int) -> jax.Array:
    """Indices [count] of the likeliest of poses [C, 4], `APART` from each other."""
    is_apart = jnp.abs(poses @ poses.T) < jnp.cos(jnp.deg2rad(APART) / 2)

    def take(left, _):
        best = jnp.argmax(left)
        return jnp.where(is_apart[best], left, -jnp.inf), best

    return jax.lax.scan(take, posteriors, length=count)[1]


def render_finest(
    scene: Scene,
    pose: jax.Array,
    camera: Mapping[str, Any],
    *,
    signals: tuple[str, ...] = ("silhouette",),
    config: Config,
) -> Projection:
    """A shape in the finest grid, seen from a pose [4].

    Args:
      scene: sizes in voxels of the base grid. camera: as `Observation.camera`.
    """
    render, kind = config.render, find_shape_class(config.network.shape)
    return kind.render(
        kind.resize(scene, render.finest / render.grid),
        _place_view(pose, camera, render.finest, config),
        signals=signals,
        background_depth=find_background(render.distance),
    )


def weigh_finest(scene: Scene, config: Config) -> Scene:
    """A scene for the finest grid, as dense as training renders last."""
    kind, render = find_shape_class(config.network.shape), config.render
    return kind.resize(
        kind.weigh_as_trained(scene, render), render.finest / render.grid
    )


def search_nearby(
    scene: Scene, pose: jax.Array, fine: Observation, *, config: Config
) -> tuple[jax.Array, jax.Array]:
    """The viewpoint [4] near a predicted one that explains the image best, its loss ().

    A head predicts a viewpoint by features of the whole image, a few degrees off;
    outlines in the finest grid tell single degrees. In each round a parabola through
    the costs here and `REACH` away to both sides tells the best azimuth, another one
    the best elevation; further than that it is not trusted. Elevations stay in the
    range of the heads. Where the image is explained no better, the pose stays. Not in
    the paper.

    Args:
      scene: of the shape, sizes in voxels of the base grid.
      pose: [4] quaternion of an upright camera.
    """
    finer, reach = weigh_finest(scene, config), jnp.deg2rad(REACH)
    limits = config.pose.elevation_low, config.pose.elevation_high
    low, high = (jnp.deg2rad(angle) for angle in limits)
    # Azimuth and elevation, one to each side.
    sides = reach * jnp.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]], pose.dtype)
    turn = jax.vmap(_turn_view, in_axes=(None, 0))

    def measure(poses):
        return compare_poses(finer, poses, fine, config=config)

    def move(pose, _):
        here, left, right, below, above = measure(turn(pose, sides))
        azimuth = reach * _find_lowest(left, here, right)
        elevation = read_elevations(pose)
        rise = reach * _find_lowest(below, here, above)
        rise = jnp.clip(elevation + rise, low, high) - elevation
        return _turn_view(pose, jnp.stack([azimuth, rise])), None

    found, _ = jax.lax.scan(move, pose, length=ROUNDS)
    before, after = measure(jnp.stack([pose, found]))
    is_better = after < before
    return jnp.where(is_better, found, pose), jnp.minimum(before, after)


def _find_lowest(left: jax.Array, here: jax.Array, right: jax.Array) -> jax.Array:
    """Where a parabola through costs at -1, 0 and 1 is lowest, between -1 and 1."""
    curve, slope = left - 2 * here + right, (left - right) / 2
    is_valley = curve > 0
    lowest = slope / jnp.where(is_valley, curve, 1)
    return jnp.clip(jnp.where(is_valley, lowest, jnp.sign(slope)), -1, 1)


def _turn_view(pose: jax.Array, angles: jax.Array) -> jax.Array:
    """The pose [4] of a viewpoint [2] radians farther in azimuth and elevation."""
    cos, sin = jnp.cos(angles / 2), jnp.sin(angles / 2)
    zero = jnp.zeros((), pose.dtype)
    about_up = jnp.stack([cos[0], zero, zero, -sin[0]])  # the object's z
    about_side = jnp.stack([cos[1], sin[1], zero, zero])  # the camera's x
    turned = quaternion.multiply(pose, about_up)
    return quaternion.multiply(about_side, turned)
