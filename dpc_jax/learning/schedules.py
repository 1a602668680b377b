"""Schedules over a run: point size, dropout, learning rate (§ Training details)."""

from typing import NamedTuple

import chex
import jax.numpy as jnp
import optax

from dpc_jax.config.settings import Settings


def compute_sigma(step: chex.Numeric, settings: Settings) -> chex.Array:
    """Standard deviation of a point in voxels of `settings.grid`; linear in the step.

    The paper goes from 5 % to 0.3 % of the volume, at every resolution.
    """
    annealed = settings.anneal_until * settings.steps
    done = jnp.clip(jnp.asarray(step, jnp.float32) / annealed, 0, 1)
    share = settings.sigma_start + done * (settings.sigma_end - settings.sigma_start)
    return share * settings.grid


def count_kept_points(step: int, settings: Settings) -> int:
    """How many points a step renders; linear in the step, in `keep_levels` stairs.

    A Python number: points left out are not rendered at all, and each stair is a
    program of its own, compiled when first reached.
    """
    levels = settings.keep_levels
    annealed = settings.anneal_until * settings.steps
    level = min(int(step * levels / annealed), levels - 1)
    # The middle of the stair lies on the line; the last stair keeps the end value.
    done = 1.0 if level == levels - 1 else (level + 0.5) / levels
    share = settings.keep_start + done * (settings.keep_end - settings.keep_start)
    return max(1, round(share * settings.num_points))


class Stage(NamedTuple):
    """What is static about a step; each stage is a program of its own.

    Attributes:
      kept_points: number of points rendered.
      grid: side of the volume that the winners are rendered in.
    """

    kept_points: int
    grid: int


def find_stage(step: int, settings: Settings) -> Stage:
    """The stage that a step belongs to."""
    return Stage(
        kept_points=count_kept_points(step, settings),
        grid=settings.fine_grid
        if settings.fine_grid and step >= settings.fine_from * settings.steps
        else settings.grid,
    )


def make_learning_rate(settings: Settings) -> optax.Schedule:
    """Linear warm-up to the peak rate, then cosine decay to a share of it."""
    decay = optax.cosine_decay_schedule(
        settings.learning_rate,
        max(1, settings.steps - settings.warmup_steps),
        alpha=settings.final_rate,
    )
    if not settings.warmup_steps:
        return decay
    warmup = optax.linear_schedule(
        settings.learning_rate / settings.warmup_steps,
        settings.learning_rate,
        settings.warmup_steps,
    )
    return optax.join_schedules([warmup, decay], [settings.warmup_steps])
