"""Gradient descent on a cloud and its cameras, coarse to fine."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.fitting import FitSettings
from dpc_jax.learning.fitting.cloud import (
    METHOD,
    Cloud,
    compare_views,
    take_views,
)
from dpc_jax.learning.losses import (
    containment_loss,
    measure_outside,
    pull_inside,
    repulsion_energy,
)
from dpc_jax.learning.signals import Weights, average_blocks
from dpc_jax.render import Camera, VoxelGrid
from dpc_jax.render.batch import find_room, sort_inputs

CHUNK = 10  # steps of one call
COARSE_UP_TO = 128  # side of images up to which a step sees all views
_FINE_VIEWS = 4  # of a step in finer ones
_SPARE = 1.2  # room for blocks over what the first step of a side touches
_FINER_RATE = 0.4  # learning rate of a side over that of the one before
_CAMERA_SHARE = 0.1, 0.6  # of that rate, of the cameras: first side, finer ones
_COARSE_END = 1.25  # size of points at the end of a coarser side over that of the last
_REPELLED = 600  # points that repel each other in a step
_COLOR_SHARE = 5.0  # rate of colours' logits, which have several units to go


class Stage(NamedTuple):
    """What is static about the steps of a side."""

    settings: FitSettings
    number: int  # of the side
    weights: Weights

    @property
    def steps(self) -> int:
        """Of this side."""
        return self.settings.steps[self.number]


def descend(
    cloud: Cloud,
    targets: dict[str, jax.Array],
    camera: Camera,
    stage: Stage,
    *,
    on_progress: Callable[[int, float], None],
) -> Cloud:
    """All steps of a side.

    Args:
      targets: of all views at this side.
      on_progress: called with the steps taken and the loss, without the priors.
    """
    silhouettes = targets["silhouette"]
    near = average_blocks(silhouettes, min(silhouettes.shape[-1], COARSE_UP_TO))
    outside = jax.lax.map(measure_outside, near)
    parameters: Any = cloud
    state = _make_optimizer(stage).init(parameters)
    side = silhouettes.shape[-1]
    sigma = _find_sigma(stage, jnp.zeros(()))
    room = _find_room(cloud, sigma, side, camera)
    for first in range(0, stage.steps, CHUNK):
        inputs = cloud, state, jnp.asarray(first), targets, outside, camera
        moved = _advance(*inputs, stage=stage, max_blocks=room)
        while room and room < side**3 and not jnp.isfinite(moved[2]):
            room *= 2  # the images of more blocks than there is room for are NaN
            moved = _advance(*inputs, stage=stage, max_blocks=room)
        cloud, state, loss = moved
        on_progress(min(first + CHUNK, stage.steps), float(loss))
    return cloud


def _find_room(cloud: Cloud, sigma, side: int, camera: Camera) -> int | None:
    """`max_blocks` for all views, some to spare; None for the whole volume."""
    if side <= COARSE_UP_TO:  # where points start wide, and programs cost more
        return None
    seen = place_camera(camera, cloud.list_views(camera))
    values = {"points": cloud.points, "sigma": sigma, **seen.list_numbers()}
    values |= {"translations": cloud.translations}
    shared, own = sort_inputs(values, batch_size=len(cloud.rotations))
    own["rotation"] = cloud.rotations
    how = camera.projection, VoxelGrid(side), METHOD
    return find_room(shared, own, *how, spare=_SPARE)


def _make_optimizer(stage: Stage) -> optax.GradientTransformation:
    """Adam of the cloud and what is learned of cameras, its rate falling to a tenth."""
    settings, steps = stage.settings, stage.steps
    # A finer side begins near the end of the coarser one's.
    peak = settings.learning_rate * _FINER_RATE**stage.number
    rate = optax.cosine_decay_schedule(peak, steps, alpha=0.1)

    def camera_rate(step):
        # From a sphere no camera can be told: at first the cloud moves alone.
        begun = 1.0 if stage.number else jnp.clip(5 * step / steps - 1.5, 0, 1)
        return _CAMERA_SHARE[min(stage.number, 1)] * begun * rate(step)

    # A cloud has the others of its cameras only where they are learned.
    kinds = {"rotations": "given", "translations": "camera", "log_focal": "camera"}
    kinds |= {"color_logits": "colors"}

    def label(path, _):
        return kinds.get(path[0].name, "cloud")

    return optax.multi_transform(
        {
            "cloud": optax.adam(rate),
            "colors": optax.adam(lambda step: _COLOR_SHARE * rate(step)),
            "camera": optax.adam(camera_rate),
            "given": optax.set_to_zero(),
        },
        lambda cloud: jax.tree_util.tree_map_with_path(label, cloud),
    )


def _find_sigma(stage: Stage, number):
    """Of a step; coarse sides end, and finer ones begin, with the same size."""
    first, last = stage.settings.sigma
    is_last = stage.number == len(stage.settings.steps) - 1
    start = first if stage.number == 0 else 2 * _COARSE_END * last
    end = last * (1.0 if is_last else _COARSE_END)
    share = number / stage.steps
    return start * (end / start) ** share


def _choose_views(number, shape):
    """Some of the views for a step in fine images [V, D, D]; None for all."""
    count, side = shape[:2]
    if side <= COARSE_UP_TO or count <= _FINE_VIEWS:
        return None
    return jax.random.choice(
        jax.random.key(number), count, (_FINE_VIEWS,), replace=False
    )


def _pull(cloud: Cloud, outside, camera, chosen):
    """`pull_inside` of the chosen views in the mean; (). Outside is [V, D, D]."""

    def measure(entry):
        own, distances = entry
        return pull_inside(
            cloud.points,
            own["rotation"],
            distances,
            camera=place_camera(camera, own),
            translation=own.get("translation"),
        )

    entries = take_views((cloud.list_views(camera), outside), chosen)
    return jnp.mean(jax.vmap(measure)(entries))


@functools.partial(jax.jit, static_argnames=("stage", "max_blocks"))
def _advance(cloud, state, first, targets, outside, camera, *, stage, max_blocks):
    """`CHUNK` steps from the first; cloud, optimizer's state, loss of the last."""
    settings, optimizer = stage.settings, _make_optimizer(stage)

    def compare(cloud, number):
        how = {"sigma": _find_sigma(stage, number), "weights": stage.weights}
        how |= {"camera": camera, "max_blocks": max_blocks}
        chosen = _choose_views(number, targets["silhouette"].shape)
        loss = compare_views(cloud, targets, chosen=chosen, **how)
        total = loss + settings.pull_weight * _pull(cloud, outside, camera, chosen)
        # Outside of the volume there is no gradient from images.
        total += containment_loss(cloud.points)
        if settings.repulsion_weight:
            count, key = len(cloud.points), jax.random.key(number)
            shape = (min(count, _REPELLED),)
            some = jax.random.choice(key, count, shape, replace=False)
            energy = repulsion_energy(cloud.points[some])
            total += settings.repulsion_weight * energy
        if cloud.translations is not None:
            total += jnp.sum(jnp.mean(cloud.translations, axis=0) ** 2)
        if cloud.log_focal is not None:
            total += jnp.mean(cloud.log_focal) ** 2
        return total, loss

    def step(carry, number):
        cloud, state = carry
        slopes, loss = jax.grad(compare, has_aux=True)(cloud, number)
        updates, state = optimizer.update(slopes, state, cloud)
        return (optax.apply_updates(cloud, updates), state), loss

    numbers = first + jnp.arange(CHUNK)
    (cloud, state), losses = jax.lax.scan(step, (cloud, state), numbers)
    return cloud, state, losses[-1]
