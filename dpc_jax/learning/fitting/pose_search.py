"""Poses of the views of one object from nothing: stochastic expectation maximisation.

The K candidates of a view are a grid of viewpoints around the object. In each round all
are compared with every view; then the cloud takes a few steps, each with one pose per
view that is drawn with probability ∝ exp(-loss / temperature). The temperature falls:
at first nearly all poses are tried, at the end the best one stays. Where the best one
is taken from the start (Eq. 2), accidents of the first cloud decide for good.

It is repeated from several random clouds, in coarse images; the best goes on in finer
ones, among more viewpoints.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.learning.fitting import FitSettings
from dpc_jax.learning.fitting.cloud import Cloud, compare_views, find_losses
from dpc_jax.learning.signals import SILHOUETTES, make_targets
from dpc_jax.networks.viewpoints import list_viewpoints
from dpc_jax.render import Camera

_STEPS = 5  # of the cloud in a round
_ADAM = optax.adam(0.01)


class Level(NamedTuple):
    """A resolution of the search.

    Attributes:
      side: of images and volume. num_points: of the cloud.
      azimuths, rings: of the viewpoints, in equal steps.
      sigma: of the points at the start and at the end, voxels of that grid.
      temperature: of a pixel's mean squared difference. Above the first all poses are
        alike, below the last the second best is hardly ever drawn.
    """

    side: int
    num_points: int
    azimuths: int
    rings: int
    sigma: tuple[float, float]
    temperature: tuple[float, float]


COARSE = Level(16, 300, 24, 4, (2.0, 0.75), (4e-3, 2e-4))
FINE = Level(32, 800, 36, 6, (1.5, 0.75), (4e-4, 1e-4))


def search_poses(
    views: Mapping[str, np.ndarray],
    key: jax.Array,
    *,
    settings: FitSettings,
    camera: Camera,
    tell: Callable[[str, int, int], None],
) -> np.ndarray:
    """The rotations [V, 4] that the best of several searches ends with.

    Args:
      views: with masks [V, S, S], of `make_targets`.
      key: another one gives other searches.
      settings: how many searches, of how many rounds in coarse images (half as many in
        finer ones follow the best), and the range of elevations.
      tell: called with what is done, a count and a total.
    """
    what, searches = "searching for poses", settings.searches
    names, distance = ("silhouette",), float(camera.distance)

    def search(level, points, log_mass, key, rounds):
        targets = make_targets(views, level.side, signals=names, distance=distance)
        viewpoints = list_viewpoints(
            settings.elevations, azimuths=level.azimuths, rings=level.rings
        )
        rotations = jnp.broadcast_to(viewpoints[0], (len(views["masks"]), 4))
        return _search(
            Cloud(points, log_mass, None, rotations, None, None),
            targets["silhouette"],
            viewpoints,
            key,
            level=level,
            rounds=rounds,
            camera=camera,
        )

    found = []
    for number in range(searches):
        tell(what, number, searches + 1)
        start, own = jax.random.split(jax.random.fold_in(key, number))
        points = 0.25 * jax.random.normal(start, (COARSE.num_points, 3))
        points = jnp.clip(points, -0.45, 0.45)
        found.append(search(COARSE, points, jnp.zeros(()), own, settings.rounds))
    tell(what, searches, searches + 1)
    best, _ = min(found, key=lambda one: one[1])
    near, own = jax.random.split(jax.random.fold_in(key, searches))
    picks, noise = jax.random.split(near)
    chosen = jax.random.choice(picks, best.points, (FINE.num_points,))
    spread = 0.5 / COARSE.side * jax.random.normal(noise, chosen.shape)
    rounds = (settings.rounds + 1) // 2
    last, _ = search(FINE, chosen + spread, best.log_mass, own, rounds)
    tell(what, searches + 1, searches + 1)
    return np.asarray(last.rotations)


def _search(
    cloud: Cloud, silhouettes, viewpoints, key, *, level: Level, rounds: int, camera
) -> tuple[Cloud, float]:
    """(a cloud with the best viewpoint of each view, its mean loss per pixel)."""
    state = _ADAM.init((cloud.points, cloud.log_mass))
    losses = jnp.zeros((len(silhouettes), len(viewpoints)))
    for number, own in enumerate(jax.random.split(key, rounds)):
        share = number / max(rounds - 1, 1)
        sigma, temperature = (
            jnp.asarray(first * (last / first) ** share, cloud.points.dtype)
            for first, last in (level.sigma, level.temperature)
        )
        cloud, state, losses = _run_round(
            cloud, state, own, sigma, temperature, silhouettes, viewpoints, camera
        )
    best = viewpoints[jnp.argmin(losses, axis=1)]
    return cloud._replace(rotations=best), float(jnp.mean(jnp.min(losses, axis=1)))


@jax.jit
def _run_round(cloud, state, key, sigma, temperature, silhouettes, viewpoints, camera):
    """Compare all, then a few steps; cloud, the optimizer's state, losses [V, K]."""
    losses = find_losses(cloud, viewpoints, silhouettes, sigma=sigma, camera=camera)
    compare_all = functools.partial(
        compare_views,
        targets={"silhouette": silhouettes},
        sigma=sigma,
        weights=SILHOUETTES,
        camera=camera,
    )

    def step(carry, key):
        cloud, state = carry
        drawn = viewpoints[jax.random.categorical(key, -losses / temperature)]

        def compare(learned):
            points, log_mass = learned
            posed = cloud._replace(points=points, log_mass=log_mass, rotations=drawn)
            return compare_all(posed)

        learned = cloud.points, cloud.log_mass
        updates, state = _ADAM.update(jax.grad(compare)(learned), state)
        moved: Any = optax.apply_updates(learned, updates)
        points, log_mass = moved
        return (cloud._replace(points=points, log_mass=log_mass), state), None

    keys = jax.random.split(key, _STEPS)
    (cloud, state), _ = jax.lax.scan(step, (cloud, state), keys)
    return cloud, state, losses
