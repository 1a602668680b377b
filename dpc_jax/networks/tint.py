"""The mean colour of an image's object: what its points' colours begin from.

Not in the paper. Features of the encoder differ between objects by a tenth of their
size, so that layers behind them learn the category's mean colours long before those of
an object (docs/log.md). The mean colour of an image needs no learning.
"""

import jax
import jax.numpy as jnp

TINT = 3  # numbers of an image
_WHITE = 0.97  # from which on all channels are the background
_BOUND = 0.02  # colours nearer to 0 or 1 than this count as if they were not


def measure_tint(images: jax.Array) -> jax.Array:
    """Logits [B, 3] of the mean colour of what is not white in images [B, S, S, 3].

    Images are in [-1, 1]; one that is all white is grey.
    """
    colors = (images + 1) / 2
    covered = jnp.min(colors, axis=-1, keepdims=True) < _WHITE
    count = jnp.sum(covered, axis=(1, 2))
    mean = jnp.sum(colors * covered, axis=(1, 2)) / jnp.maximum(count, 1)
    mean = jnp.where(count > 0, jnp.clip(mean, _BOUND, 1 - _BOUND), 0.5)
    return jnp.log(mean) - jnp.log1p(-mean)
