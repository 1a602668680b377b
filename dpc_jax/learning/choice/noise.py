"""Noise in the choice among candidates: worse ones are tried, too, early in a run.

Not in the paper. Where the best candidate is taken from the first step on, accidents
of the first shape may decide for good which pose explains a view.
"""

import functools

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose


def draw_noise(
    keys: jax.Array, step: jax.Array, shape: tuple[int, ...], *, pose: Pose, steps: int
) -> jax.Array | None:
    """Noise [B·V, C] for the choice; None where the config has none.

    With Gumbel noise of scale T the smallest of several losses is a draw with
    probability ∝ exp(-loss / T). T falls in a straight line to 0.

    Args:
      keys: [B], of the objects. step: (). shape: (B·V, C). steps: of the run.
    """
    if not pose.choice_noise:
        return None
    left = jnp.maximum(0, 1 - step / (pose.choice_noise_until * steps))
    own = jax.vmap(functools.partial(jax.random.fold_in, data=3))(keys)
    count = shape[0] // keys.shape[0], shape[1]
    drawn = jax.vmap(lambda key: jax.random.gumbel(key, count))(own)
    return -pose.choice_noise * left * drawn.reshape(shape)


def disturb(
    losses: jax.Array, noise: jax.Array | None, which: jax.Array | slice = slice(None)
) -> jax.Array:
    """Losses with noise in shares of their mean; of which [C] of all there is noise."""
    return losses if noise is None else losses + jnp.mean(losses) * noise[which]
