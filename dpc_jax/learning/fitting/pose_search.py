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
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.learning.fitting.cloud import Cloud, compare_views, find_losses
from dpc_jax.learning.signals import SILHOUETTES
from dpc_jax.networks.viewpoints import face_object
from dpc_jax.render import Camera

_STEPS = 5  # of the cloud in a round
_RATE = 0.01


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


class Found(NamedTuple):
    """Where a search has come to.

    Attributes:
      points: of its cloud. log_mass: of `Cloud`.
      rotations: [V, 4], of each view the best viewpoint.
      loss: its mean loss per pixel.
    """

    points: jax.Array
    log_mass: jax.Array
    rotations: jax.Array
    loss: float


def search_poses(
    read_silhouettes: Callable[[int], jax.Array],
    key: jax.Array,
    *,
    searches: int,
    rounds: int,
    elevations: tuple[float, float],
    camera: Camera,
    tell: Callable[[str, int, int], None],
) -> np.ndarray:
    """The rotations [V, 4] that the best of several searches ends with.

    Args:
      read_silhouettes: [V, side, side] of a side.
      key: another one gives other searches. searches: how many.
      rounds: of each, in coarse images; half as many in finer ones follow the best.
      elevations: lowest and highest of the cameras, degrees.
      tell: called with what is done, a count and a total.
    """
    what, total = "searching for poses", searches + 1
    found = []
    for number in range(searches):
        tell(what, number, total)
        start, own = jax.random.split(jax.random.fold_in(key, number))
        points = 0.25 * jax.random.normal(start, (COARSE.num_points, 3))
        found.append(
            _search(
                jnp.clip(points, -0.45, 0.45),
                jnp.zeros(()),
                read_silhouettes(COARSE.side),
                list_viewpoints(elevations, COARSE),
                own,
                level=COARSE,
                rounds=rounds,
                camera=camera,
            )
        )
    tell(what, searches, total)
    best = min(found, key=lambda one: one.loss)
    near, own = jax.random.split(jax.random.fold_in(key, searches))
    picks, noise = jax.random.split(near)
    chosen = jax.random.choice(picks, best.points, (FINE.num_points,))
    spread = 0.5 / COARSE.side * jax.random.normal(noise, chosen.shape)
    last = _search(
        chosen + spread,
        best.log_mass,
        read_silhouettes(FINE.side),
        list_viewpoints(elevations, FINE),
        own,
        level=FINE,
        rounds=(rounds + 1) // 2,
        camera=camera,
    )
    tell(what, total, total)
    return np.asarray(last.rotations)


def list_viewpoints(elevations: tuple[float, float], level: Level) -> jax.Array:
    """Upright cameras [azimuths·rings, 4] that look at the origin from all around.

    Args:
      elevations: lowest and highest, degrees.
    """
    low, high = (jnp.deg2rad(angle) for angle in elevations)
    around = jnp.arange(level.azimuths) * 2 * jnp.pi / level.azimuths
    height = low + (high - low) * (jnp.arange(level.rings) + 0.5) / level.rings
    return face_object(*(g.ravel() for g in jnp.meshgrid(around, height)))


def _search(
    points, log_mass, silhouettes, viewpoints, key, *, level, rounds, camera
) -> Found:
    rotations = jnp.broadcast_to(viewpoints[0], (len(silhouettes), 4))
    cloud = Cloud(points, log_mass, None, rotations, None, None)
    state = _optimizer().init((points, log_mass))
    losses = jnp.zeros((len(silhouettes), len(viewpoints)))
    for number, own in enumerate(jax.random.split(key, rounds)):
        share = number / max(rounds - 1, 1)
        sigma, temperature = (
            jnp.asarray(first * (last / first) ** share, points.dtype)
            for first, last in (level.sigma, level.temperature)
        )
        cloud, state, losses = _run_round(
            cloud, state, own, sigma, temperature, silhouettes, viewpoints, camera
        )
    best = viewpoints[jnp.argmin(losses, axis=1)]
    loss = float(jnp.mean(jnp.min(losses, axis=1)))
    return Found(cloud.points, cloud.log_mass, best, loss)


def _optimizer():
    return optax.adam(_RATE)


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
            return jnp.mean(compare_all(posed))

        learned = cloud.points, cloud.log_mass
        updates, state = _optimizer().update(jax.grad(compare)(learned), state)
        moved: Any = optax.apply_updates(learned, updates)
        points, log_mass = moved
        return (cloud._replace(points=points, log_mass=log_mass), state), None

    keys = jax.random.split(key, _STEPS)
    (cloud, state), _ = jax.lax.scan(step, (cloud, state), keys)
    return cloud, state, losses
