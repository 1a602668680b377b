"""Gradient descent on a cloud and its cameras, coarse to fine."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning.fitting import cloud as clouds
from dpc_jax.learning.fitting.settings import FitSettings
from dpc_jax.learning.losses import containment_loss
from dpc_jax.learning.signals import Weights
from dpc_jax.render import Camera, quaternion

CHUNK = 10  # steps of one call
_FINER_RATE = 0.4  # learning rate of a side over that of the one before
_COARSE_END = 1.4  # size of points at the end of a coarser side over that of the last


class Stage(NamedTuple):
    """What is static about the steps of a side."""

    settings: FitSettings
    number: int  # of the side
    weights: Weights
    learned: tuple[str, ...]  # of `Cloud`, of the cameras

    @property
    def steps(self) -> int:
        """Of this side."""
        return self.settings.steps[self.number]

    @property
    def is_last(self) -> bool:
        """Whether no finer side follows."""
        return self.number == len(self.settings.steps) - 1


def make_optimizer(stage: Stage) -> optax.GradientTransformation:
    """Adam for the steps of a side, its rate falling to a tenth."""
    settings, steps = stage.settings, stage.steps
    # A finer side begins near the end of the coarser one's.
    peak = settings.learning_rate * _FINER_RATE**stage.number
    rate = optax.cosine_decay_schedule(peak, steps, alpha=0.1)

    def camera_rate(step):
        # From a sphere no pose can be told: at first the cloud moves alone.
        begun = 1.0 if stage.number else jnp.clip(5 * step / steps - 1.5, 0, 1)
        return settings.camera_share[min(stage.number, 1)] * begun * rate(step)

    return clouds.make_optimizer(
        rate=rate, camera_rate=camera_rate, learned=stage.learned
    )


@functools.partial(jax.jit, static_argnames="stage", donate_argnums=(0, 1))
def advance(
    cloud: clouds.Cloud,
    state: optax.OptState,
    first: jax.Array,
    targets: dict[str, jax.Array],
    outside: jax.Array,
    camera: Camera,
    *,
    stage: Stage,
) -> tuple[clouds.Cloud, optax.OptState, jax.Array]:
    """A few steps of gradient descent; the last one's loss is without the priors.

    Args:
      first: () number of the first step. targets: of all views.
      outside: [V, D, D], see `measure_outside`.
    """
    settings = stage.settings
    optimizer = make_optimizer(stage)
    # Coarse ones end, and finer ones begin, with the same size in the object.
    start = (
        settings.sigma[0] if stage.number == 0 else 2 * _COARSE_END * settings.sigma[1]
    )
    end = settings.sigma[1] * (1.0 if stage.is_last else _COARSE_END)

    def compare(cloud, number):
        share = number / stage.steps
        sigma = start * (end / start) ** share
        loss = jnp.mean(
            clouds.compare_views(
                cloud, targets, sigma=sigma, weights=stage.weights, camera=camera
            )
        )
        total = loss + settings.pull_weight * clouds.pull(cloud, outside, camera=camera)
        # Outside of the volume there is no gradient from images.
        total += containment_loss(cloud.points)
        if settings.repulsion_weight:
            energy = clouds.repel(cloud, jax.random.key(number))
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
        moved: Any = optax.apply_updates(cloud, updates)
        unit = jax.vmap(quaternion.normalize)(moved.rotations)
        return (moved._replace(rotations=unit), state), loss

    numbers = first + jnp.arange(CHUNK)
    (cloud, state), losses = jax.lax.scan(step, (cloud, state), numbers)
    return cloud, state, losses[-1]
