"""Poses of the views of one object, from rough ones or from nothing.

Coarse images come first, by stochastic expectation maximisation. The K candidates of a
view are a grid of viewpoints around the object, or of turns about its rough pose. In
each round all are compared with the view; then the cloud takes a few steps, each with
one pose per view that is drawn with probability ∝ exp(-loss / temperature). The
temperature falls: at first nearly all poses are tried, at the end the best one stays.
Where the best one is taken from the start (Eq. 2), accidents of the first cloud decide
for good. So do images of 16² pixels where front and back look alike in them: from
nothing the temperature falls in images of 32².

In finer images the cloud and the poses take the same steps of Adam. A step of each in
turn, the other held, keeps an error that all views share: the cloud has bent to it. Now
and then the likeliest candidates get Levenberg-Marquardt steps (`pose_steps`), and the
best of them and the pose goes on. This is repeated from several random clouds; the best
is improved in the finest images.
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

SEARCHED_SIDE = 32  # which divides that of the images
_DRAWN_RATE = 0.16  # of the points while poses are drawn, voxels
# Against views that are all placed on one side of the object: on the other the cloud
# is no shape then, and reversed views cannot go there one by one.
_SPREAD = 4.0
_ASIDE = (-20.0, -10.0, 0.0, 10.0, 20.0)  # of turns about each axis, degrees
_SIGMA = (1.0, 0.75)  # in the finer images
_RATE = (5e-3, 5e-4)
_POSE_SHARE = 0.3  # of that rate, of quaternions and translations
_LIKELY, _TRIED = 4, 5  # candidates compared with a found pose, by so many steps
_STEPS = 5  # in a round
_ADAM = optax.scale_by_adam()
_CLOUD, _POSES = ("points", "log_mass"), ("rotations", "translations")


class Drawn(NamedTuple):
    """A resolution in which poses are drawn.

    Attributes:
      side: of images and volume. num_points: of the cloud.
      sigma: of the points in the first and the last round, voxels.
      temperature: in these, of a pixel's mean squared difference. At the highest all
        poses are alike, at the lowest the second best is hardly ever drawn.
      viewpoints: azimuths and rings of the candidates, in equal steps; None for turns.
      rounds: each a comparison and a few steps.
    """

    side: int
    num_points: int
    sigma: tuple[float, float]
    temperature: tuple[float, float]
    viewpoints: tuple[int, int] | None
    rounds: int


class Level(NamedTuple):
    """A finer resolution, in which poses move.

    Attributes:
      side: of images and volume. num_points: of the cloud.
      rounds: of steps.
      compared: after which of them each view is compared with its candidates again.
    """

    side: int
    num_points: int
    rounds: int
    compared: tuple[int, ...]


NEAR = (Drawn(16, 300, (2.0, 0.75), (4e-3, 2e-4), None, 100),)
FROM_NOTHING = (
    Drawn(16, 300, (2.0, 1.2), (4e-3, 4e-3), (24, 4), 60),
    Drawn(32, 600, (2.0, 0.75), (4e-3, 1e-4), (48, 6), 60),
)
FINER = (Level(32, 800, 60, (10, 20, 30, 40)), Level(64, 2000, 80, (10,)))


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
      settings: how many searches.
      tell: called with what is done, a count and a total.
    """
    side, count = views["masks"].shape[-1], len(views["masks"])
    finer = [level for level in FINER if side % level.side == 0]
    # Those near rough poses seldom fail.
    searches = settings.searches if rough is None else (settings.searches + 1) // 2
    what, total = "searching for poses", searches + len(finer[1:])
    drawn = [
        (level, _list_candidates(rough, level.viewpoints, settings))
        for level in (FROM_NOTHING if rough is None else NEAR)
    ]
    candidates = drawn[-1][1]

    @functools.cache
    def read(side):
        names, distance = ("silhouette",), float(camera.distance)
        return make_targets(views, side, signals=names, distance=distance)["silhouette"]

    def search(number):
        tell(what, number, total)
        start, *keys, near = jax.random.split(jax.random.fold_in(key, number), 4)
        cloud = _draw_cloud(start, drawn[0][0].num_points, count)
        for (level, candidates), own in zip(drawn, keys, strict=False):
            cloud = _draw_poses(cloud, read(level.side), candidates, own, level, camera)
        cloud = cloud._replace(translations=translations)
        return improve(cloud, read(finer[0].side), candidates, near, finer[0], camera)

    cloud, _ = min(map(search, range(searches)), key=lambda one: one[1])
    for number, level in enumerate(finer[1:], searches):
        tell(what, number, total)
        own = jax.random.fold_in(key, number)
        cloud, _ = improve(cloud, read(level.side), candidates, own, level, camera)
    tell(what, total, total)
    return cloud


def _list_candidates(rough, viewpoints, settings: FitSettings) -> jax.Array:
    """[K, 4] for all views, or [V, K, 4] about rough poses [V, 4]."""
    if rough is None:
        azimuths, rings = viewpoints
        return list_viewpoints(settings.elevations, azimuths=azimuths, rings=rings)
    turns = np.deg2rad(list(itertools.product(_ASIDE, repeat=3)))
    turns = Rotation.from_rotvec(turns).as_quat(scalar_first=True)[None]
    multiply = jnp.vectorize(quaternion.multiply, signature="(q),(q)->(q)")
    return multiply(turns.astype(np.float32), jnp.asarray(rough)[:, None])


def _draw_cloud(key, num_points: int, num_views: int) -> Cloud:
    """A ball of points; without poses."""
    points = 0.25 * jax.random.normal(key, (num_points, 3))
    rotations = jnp.broadcast_to(jnp.asarray(quaternion.IDENTITY), (num_views, 4))
    points = jnp.clip(points, -0.45, 0.45)
    return Cloud(points, jnp.zeros(()), None, rotations, None, None)


def _between(ends: tuple[float, float], number: int, rounds: int) -> jax.Array:
    """From one end in the first round to the other in the last, by equal factors."""
    share = number / max(rounds - 1, 1)
    return jnp.float32(ends[0] * (ends[1] / ends[0]) ** share)


def _draw_points(cloud: Cloud, key, num_points: int, side: int) -> Cloud:
    """So many points near those of the cloud, by half a voxel of the grid."""
    picks, noise = jax.random.split(key)
    points = jax.random.choice(picks, cloud.points, (num_points,))
    points += 0.5 / side * jax.random.normal(noise, points.shape)
    return cloud._replace(points=points)


def _draw_poses(
    cloud: Cloud, silhouettes, candidates, key, level: Drawn, camera: Camera
) -> Cloud:
    """By expectation maximisation; with the best candidates."""
    if len(cloud.points) < level.num_points:
        key, own = jax.random.split(key)
        cloud = _draw_points(cloud, own, level.num_points, level.side)
    rate = jnp.float32(_DRAWN_RATE / level.side)
    state, losses = _ADAM.init(_list_learned(cloud, _CLOUD)), jnp.zeros((1, 1))
    for number, own in enumerate(jax.random.split(key, level.rounds)):
        sigma, temperature = (
            _between(ends, number, level.rounds)
            for ends in (level.sigma, level.temperature)
        )
        how = sigma, rate, temperature, silhouettes, candidates, camera
        cloud, state, losses = _run_drawn_round(cloud, state, own, *how)
    return cloud._replace(rotations=_take(candidates, jnp.argmin(losses, axis=1)))


def improve(
    cloud: Cloud, silhouettes, candidates, key, level: Level, camera: Camera
) -> tuple[Cloud, float]:
    """(cloud and poses of a finer level, the mean loss per pixel)."""
    cloud = _draw_points(cloud, key, level.num_points, level.side)
    state, loss = _ADAM.init(_list_learned(cloud, _CLOUD + _POSES)), jnp.inf
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
    chances = -losses / temperature
    if candidates.ndim == 2:
        crowding = measure_crowding(candidates, jax.nn.softmax(chances))
        chances -= _SPREAD * crowding[None]

    def step(carry, key):
        cloud, state = carry
        drawn = jax.random.categorical(key, chances)
        cloud = cloud._replace(rotations=_take(candidates, drawn))
        rates = dict.fromkeys(_CLOUD, rate)
        cloud, state, _ = _step(cloud, state, silhouettes, sigma, rates, camera)
        return (cloud, state), None

    keys = jax.random.split(key, _STEPS)
    (cloud, state), _ = jax.lax.scan(step, (cloud, state), keys)
    return cloud, state, losses


def measure_crowding(candidates, shares):
    """[K] from -1 to 1, how near to where most views are, around the upright axis.

    Shares are [V, K] of the candidates [K, 4] in a view.
    """
    ways = jax.vmap(quaternion.to_matrix)(candidates)[:, 2, :2]
    ways /= jnp.maximum(jnp.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
    return ways @ jnp.mean(shares @ ways, axis=0)


@jax.jit
def _run_round(cloud, state, sigma, rate, silhouettes, camera):
    """A few steps of the cloud and the poses; cloud, state, mean loss of the last."""
    rates = dict.fromkeys(_CLOUD, rate) | dict.fromkeys(_POSES, _POSE_SHARE * rate)

    def step(carry, _):
        cloud, state = carry
        cloud, state, loss = _step(cloud, state, silhouettes, sigma, rates, camera)
        return (cloud, state), loss

    (cloud, state), losses = jax.lax.scan(step, (cloud, state), length=_STEPS)
    return cloud, state, losses[-1]


def _list_learned(cloud: Cloud, names) -> dict[str, jax.Array]:
    """Of these, what the cloud has, by name."""
    values = cloud._asdict()
    return {name: values[name] for name in names if values[name] is not None}


def _step(cloud: Cloud, state, silhouettes, sigma, rates, camera):
    """One of Adam for what has a rate; cloud, state, mean loss before it."""

    def compare(learned):
        return compare_views(
            cloud._replace(**learned),
            {"silhouette": silhouettes},
            sigma=sigma,
            weights=SILHOUETTES,
            camera=camera,
        )

    learned = _list_learned(cloud, rates)
    loss, slopes = jax.value_and_grad(compare)(learned)
    updates: Any
    updates, state = _ADAM.update(slopes, state)
    learned = {name: old - rates[name] * updates[name] for name, old in learned.items()}
    cloud = cloud._replace(**learned)
    rotations, moves = jax.vmap(quaternion.normalize)(cloud.rotations), None
    if cloud.translations is not None:
        moves = cloud.translations - jnp.mean(cloud.translations, axis=0)[None]
    return cloud._replace(rotations=rotations, translations=moves), state, loss


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
