"""Poses of the views of one object, from rough ones or from nothing.

Coarse images come first, by stochastic expectation maximisation. The K candidates of a
view are a grid of viewpoints around the object, or of turns about its rough pose. In
each round all are compared with the view; then the cloud takes a few steps, each with
one pose per view that is drawn with probability ∝ exp(-loss / temperature). The
temperature falls: at first nearly all poses are tried, at the end the best one stays.
Where the best one is taken from the start (Eq. 2), accidents of the first cloud decide
for good.

In finer images the cloud and the poses take steps in turn, the poses by
Levenberg-Marquardt (`pose_steps`). This is repeated from several random clouds; the
best goes on in the finest images.
"""

import functools
import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.spatial.transform import Rotation

from dpc_jax.learning.fitting import FitSettings
from dpc_jax.learning.fitting.cloud import Cloud, compare_views, take_views
from dpc_jax.learning.fitting.pose_steps import step_poses
from dpc_jax.learning.shapes.kind import View
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import SILHOUETTES, make_targets
from dpc_jax.networks.viewpoints import list_viewpoints
from dpc_jax.render import Camera, quaternion
from dpc_jax.render.batch import map_renders

COARSE_SIDE = 16  # of the first images and their volume
_COARSE_POINTS = 300
_COARSE_SIGMA = (2.0, 0.75)  # of the points at the start and at the end, voxels
_COARSE_RATE = 0.01  # of the points, box diagonals
# Of a pixel's mean squared difference, at the start and at the end. Above the first all
# poses are alike, below the last the second best is hardly ever drawn.
_TEMPERATURE = (4e-3, 2e-4)
_AZIMUTHS, _RINGS = 24, 4  # of the viewpoints, in equal steps
_ASIDE = (-20.0, -10.0, 0.0, 10.0, 20.0)  # of turns about each axis, degrees
_SIGMA = (1.0, 0.75)  # in the finer images
_RATE = (5e-3, 5e-4)
_LIKELY, _TRIED = 4, 5  # candidates compared with a found pose, by so many steps
_STEPS = 5  # of the cloud in a round
_ADAM = optax.scale_by_adam()


class Level(NamedTuple):
    """A finer resolution of the search.

    Attributes:
      side: of images and volume. num_points: of the cloud.
      rounds: of steps of the cloud and the poses.
      compared: after which of them each view is compared with its candidates again.
    """

    side: int
    num_points: int
    rounds: int
    compared: tuple[int, ...]


FINER = (Level(32, 800, 60, (10, 20, 30, 40)), Level(64, 2000, 40, (10,)))


def search_poses(
    views: Mapping[str, np.ndarray],
    key: jax.Array,
    *,
    rough: np.ndarray | None = None,
    translations: jax.Array | None = None,
    settings: FitSettings,
    camera: Camera,
    tell: Callable[[str, int, int], None],
) -> Cloud:
    """A coarse cloud with the poses that the best of several searches ends with.

    Args:
      views: with masks [V, S, S], of `make_targets`.
      key: another one gives other searches.
      rough: [V, 4] quaternions that the searches stay near to; None for viewpoints from
        all around, of the elevations that settings have.
      translations: [V, 3] that begin the finer images; None where views have none.
      settings: how many searches, of how many rounds in coarse images.
      tell: called with what is done, a count and a total.
    """
    side, count = views["masks"].shape[-1], len(views["masks"])
    finer = [level for level in FINER if side % level.side == 0]
    # Those near rough poses seldom fail.
    searches = settings.searches if rough is None else (settings.searches + 1) // 2
    what, total = "searching for poses", searches + len(finer[1:])
    candidates = _list_candidates(rough, settings)

    @functools.cache
    def read(side):
        names, distance = ("silhouette",), float(camera.distance)
        return make_targets(views, side, signals=names, distance=distance)["silhouette"]

    def search(number):
        tell(what, number, total)
        start, own, near = jax.random.split(jax.random.fold_in(key, number), 3)
        cloud, seen = _draw_cloud(start, count), read(COARSE_SIDE)
        inputs = seen, candidates, own, settings.rounds, camera
        cloud, loss = _draw_poses(cloud, *inputs)
        cloud = cloud._replace(translations=translations)
        for level in finer[:1]:
            seen = read(level.side)
            cloud, loss = _improve(cloud, seen, candidates, near, level, camera)
        return cloud, loss

    cloud, _ = min(map(search, range(searches)), key=lambda one: one[1])
    for number, level in enumerate(finer[1:], searches):
        tell(what, number, total)
        own = jax.random.fold_in(key, number)
        cloud, _ = _improve(cloud, read(level.side), candidates, own, level, camera)
    tell(what, total, total)
    return cloud


def _list_candidates(rough, settings: FitSettings) -> jax.Array:
    """[K, 4] for all views, or [V, K, 4] about rough poses [V, 4]."""
    if rough is None:
        return list_viewpoints(settings.elevations, azimuths=_AZIMUTHS, rings=_RINGS)
    turns = np.deg2rad(list(itertools.product(_ASIDE, repeat=3)))
    turns = Rotation.from_rotvec(turns).as_quat(scalar_first=True)[None]
    multiply = jnp.vectorize(quaternion.multiply, signature="(q),(q)->(q)")
    return multiply(turns.astype(np.float32), jnp.asarray(rough)[:, None])


def _draw_cloud(key, num_views: int) -> Cloud:
    """A ball of points for the coarse level; without poses."""
    points = 0.25 * jax.random.normal(key, (_COARSE_POINTS, 3))
    rotations = jnp.broadcast_to(jnp.asarray(quaternion.IDENTITY), (num_views, 4))
    points = jnp.clip(points, -0.45, 0.45)
    return Cloud(points, jnp.zeros(()), None, rotations, None, None)


def _between(ends: tuple[float, float], number: int, rounds: int) -> jax.Array:
    """From one end in the first round to the other in the last, by equal factors."""
    share = number / max(rounds - 1, 1)
    return jnp.float32(ends[0] * (ends[1] / ends[0]) ** share)


def _draw_poses(
    cloud: Cloud, silhouettes, candidates, key, rounds: int, camera: Camera
) -> tuple[Cloud, float]:
    """By expectation maximisation: (with the best candidates, their mean loss)."""
    rate = jnp.float32(_COARSE_RATE)
    state, losses = _ADAM.init((cloud.points, cloud.log_mass)), jnp.zeros((1, 1))
    for number, own in enumerate(jax.random.split(key, rounds)):
        sigma = _between(_COARSE_SIGMA, number, rounds)
        how = sigma, rate, _between(_TEMPERATURE, number, rounds)
        inputs = silhouettes, candidates, camera
        cloud, state, losses = _run_drawn_round(cloud, state, own, *how, *inputs)
    cloud = cloud._replace(rotations=_take(candidates, jnp.argmin(losses, axis=1)))
    return cloud, float(jnp.mean(jnp.min(losses, axis=1)))


def _improve(
    cloud: Cloud, silhouettes, candidates, key, level: Level, camera: Camera
) -> tuple[Cloud, float]:
    """(cloud and poses of a finer level, the mean loss per pixel)."""
    picks, noise = jax.random.split(key)
    points = jax.random.choice(picks, cloud.points, (level.num_points,))
    points += 0.5 / level.side * jax.random.normal(noise, points.shape)
    cloud = cloud._replace(points=points)
    state, loss = _ADAM.init((points, cloud.log_mass)), jnp.inf
    for number in range(level.rounds):
        sigma, rate = (_between(ends, number, level.rounds) for ends in (_SIGMA, _RATE))
        cloud, state, loss = _run_round(cloud, state, sigma, rate, silhouettes, camera)
        if number + 1 in level.compared:
            cloud = _compare_again(cloud, silhouettes, candidates, sigma, camera)
    return cloud, float(loss)


@jax.jit
def _compare_again(cloud: Cloud, silhouettes, candidates, sigma, camera):
    """Each view gets the best of its pose and the likeliest candidates, after steps.

    Translations do not count in what is likely: the steps find them.
    """
    losses = _find_losses(cloud, candidates, silhouettes, sigma=sigma, camera=camera)
    _, best = jax.lax.top_k(-losses, _LIKELY)
    likely = jax.vmap(_take, (None, 1), 1)(candidates, best)
    count, size = len(silhouettes), _LIKELY + 1
    tried = jnp.concatenate([cloud.rotations[:, None], likely], axis=1).reshape(-1, 4)
    moves = cloud.translations
    repeated = None if moves is None else jnp.repeat(moves, size, axis=0)
    tried = cloud._replace(rotations=tried, translations=repeated)
    seen = jnp.repeat(silhouettes, size, axis=0)

    def step(tried, _):
        return step_poses(tried, seen, sigma=sigma, camera=camera)

    tried, losses = jax.lax.scan(step, tried, length=_TRIED)
    losses = losses[-1].reshape(count, size)
    chosen = jnp.argmin(losses, axis=1) + size * jnp.arange(count)
    tried = take_views((tried.rotations, tried.translations), chosen)
    return cloud._replace(rotations=tried[0], translations=tried[1])


def _take(candidates, chosen):
    """The chosen [V] of candidates [V, K, 4], or [K, 4]."""
    if candidates.ndim == 2:
        return candidates[chosen]
    return jnp.take_along_axis(candidates, chosen[:, None, None], axis=1)[:, 0]


@jax.jit
def _run_drawn_round(
    cloud, state, key, sigma, rate, temperature, silhouettes, candidates, camera
):
    """Compare all, then a few steps; cloud, the optimizer's state, losses [V, K]."""
    losses = _find_losses(cloud, candidates, silhouettes, sigma=sigma, camera=camera)

    def step(carry, key):
        cloud, state = carry
        drawn = jax.random.categorical(key, -losses / temperature)
        cloud = cloud._replace(rotations=_take(candidates, drawn))
        return _step_cloud(cloud, state, silhouettes, sigma, rate, camera), None

    keys = jax.random.split(key, _STEPS)
    (cloud, state), _ = jax.lax.scan(step, (cloud, state), keys)
    return cloud, state, losses


@jax.jit
def _run_round(cloud, state, sigma, rate, silhouettes, camera):
    """A few steps of the cloud, one of the poses; cloud, state, mean loss."""

    def step(carry, _):
        cloud, state = carry
        return _step_cloud(cloud, state, silhouettes, sigma, rate, camera), None

    (cloud, state), _ = jax.lax.scan(step, (cloud, state), length=_STEPS)
    cloud, losses = step_poses(cloud, silhouettes, sigma=sigma, camera=camera)
    return cloud, state, jnp.mean(losses)


def _step_cloud(cloud: Cloud, state, silhouettes, sigma, rate, camera):
    """One of Adam for points and mass; cloud, state."""

    def compare(learned):
        points, log_mass = learned
        return compare_views(
            cloud._replace(points=points, log_mass=log_mass),
            {"silhouette": silhouettes},
            sigma=sigma,
            weights=SILHOUETTES,
            camera=camera,
        )

    learned = cloud.points, cloud.log_mass
    updates, state = _ADAM.update(jax.grad(compare)(learned), state)
    points, log_mass = jax.tree.map(lambda a, b: a - rate * b, learned, updates)
    return cloud._replace(points=points, log_mass=log_mass), state


def _find_losses(cloud: Cloud, candidates, silhouettes, *, sigma, camera) -> jax.Array:
    """Loss per pixel of every candidate in every view [V, K].

    Candidates are [K, 4], the same for all views, or [V, K, 4]. Points are drawn by the
    default method: there are many candidates, and it is quicker than `METHOD`.
    """
    side = silhouettes.shape[-1]
    scene = {"points": cloud.points, "mass": cloud.find_mass(side), "sigma": sigma}

    def compare(candidates, silhouettes):
        """[V, K] of all candidates [K, 4] in silhouettes [V, D, D]."""

        def measure(candidate):
            view = View(candidate, camera, side)
            image: Any = Points.render(scene, view, signals=("silhouette",)).silhouette
            return jnp.mean((image[None] - silhouettes) ** 2, axis=(1, 2))

        return map_renders(measure, candidates, renders_at_once=None).T

    if candidates.ndim == 2:  # each is rendered once for all views
        return compare(candidates, silhouettes)
    views = candidates, silhouettes[:, None]
    return jax.lax.map(lambda view: compare(*view)[0], views)
