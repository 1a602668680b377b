"""A first, coarse choice among pose candidates. Not in the paper.

Comparing all candidates in a smaller volume and with fewer points costs a fraction of
the exact comparison, which is then made among the best few only.
"""

import jax
import jax.numpy as jnp

from dpc_jax.learning.renders import compute_candidate_losses
from dpc_jax.render import Camera
from dpc_jax.render.resolution import scale_sizes


def compute_coarse_losses(
    points: jax.Array,
    mass: jax.Array,
    candidates: jax.Array,
    target: jax.Array,
    *,
    sigma: jax.Array,
    camera: Camera,
    choice_grid: int,
    choice_points: int,
    renders_at_once: int,
) -> jax.Array:
    """Loss [C] of each candidate in a coarser volume and with fewer points.

    Arguments as of `hindsight.choose_candidate`.

    Raises:
      ValueError: where the coarser volume does not divide the target.
    """
    side = target.shape[0]
    if choice_grid and side % choice_grid:
        raise ValueError(
            f"choice_grid must divide the target's side {side}, but it is "
            f"{choice_grid}; give for example half of the side."
        )
    coarse_side = choice_grid or side
    count = min(choice_points or points.shape[0], points.shape[0])
    ratio = coarse_side / side
    factor = side // coarse_side
    # Fewer points carry the mass of all.
    shared = mass * (points.shape[0] / count)
    coarse_sigma, coarse_mass = scale_sizes(sigma, shared, ratio)
    blocks = target.reshape(coarse_side, factor, coarse_side, factor)
    return compute_candidate_losses(
        points[:count],
        coarse_mass,
        candidates,
        jnp.mean(blocks, axis=(1, 3)),
        sigma=coarse_sigma,
        camera=camera,
        renders_at_once=renders_at_once,
    )
