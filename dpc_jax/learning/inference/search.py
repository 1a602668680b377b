"""The search for the likeliest pose of a view: all around, and nearby."""

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.learning.inference.explanation import (
    Observation,
    compare_poses,
    find_posteriors,
    rank_poses,
)
from dpc_jax.learning.shapes import find_shape_class
from dpc_jax.learning.shapes.kind import Scene
from dpc_jax.networks.viewpoints import list_viewpoints, read_elevations
from dpc_jax.render import quaternion

FINALISTS = 3  # poses of a view that are compared in the finest grid
APART = 20.0  # degrees between any two of them
AZIMUTHS, ELEVATIONS = 24, 3  # of a grid of viewpoints
UNSEEN = 0.01  # probability of each, beside those of the candidates
ROUNDS, REACH = 3, 4.0  # of the search nearby; degrees that a round may move


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
    views = list_viewpoints(limits, azimuths=AZIMUTHS, rings=ELEVATIONS)
    views = views.astype(candidates.dtype)
    losses = rank_poses(scene, views, base, config=config)
    views = views[_find_peaks(views, -losses, FINALISTS)]
    chances = jnp.full(FINALISTS, UNSEEN, probabilities.dtype)
    joined = jnp.concatenate([probabilities, chances])
    return jnp.concatenate([candidates, views]), joined / jnp.sum(joined)


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
    kind = find_shape_class(config.network.shape)
    finest = kind.weigh_finest(scene, config.render)
    if config.pose.elevations:
        poses, losses = jax.lax.map(
            lambda pose: search_nearby(finest, pose, fine, config=config), poses
        )
    else:
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
      scene: of the shape, as of `Shape.weigh_finest`.
      pose: [4] quaternion of an upright camera.
    """
    reach = jnp.deg2rad(REACH)
    limits = config.pose.elevation_low, config.pose.elevation_high
    low, high = (jnp.deg2rad(angle) for angle in limits)
    # Azimuth and elevation, one to each side.
    sides = reach * jnp.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]], pose.dtype)
    turn = jax.vmap(_turn_view, in_axes=(None, 0))

    def measure(poses):
        return compare_poses(scene, poses, fine, config=config)

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
