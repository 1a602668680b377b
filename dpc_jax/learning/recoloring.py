"""Random colours of objects in the images that the encoder sees.

Not in the paper. Few real objects have few colours, by which an encoder can know them
one by one and says nothing of the next. Silhouettes that are compared, and colours that
tell how a kind stands (`choice.seen_colors`), stay those of the data.
"""

import jax
import jax.numpy as jnp

_MIXING = 2.0  # standard deviation of the logits of the shares of channels
_GAMMA = 0.5  # largest logarithm of the exponent
_GAIN = 0.4  # largest logarithm of the factor


def recolor_images(images: jax.Array, keys: jax.Array) -> jax.Array:
    """Images of B objects, each object in colours of its own; white stays white.

    What is taken from white, of each channel, becomes a random mean of that of all
    three, to a random power, times a random factor: one draw for all views of an
    object.

    Args:
      images: uint8 [B, V, S, S, 3], on white. keys: [B].
    """
    return jax.vmap(_recolor_object)(images, keys)


def _recolor_object(images, key):
    mixing, gamma, gain = jax.random.split(key, 3)
    shares = jax.nn.softmax(_MIXING * jax.random.normal(mixing, (3, 3)), axis=0)
    exponent = jnp.exp(jax.random.uniform(gamma, minval=-_GAMMA, maxval=_GAMMA))
    factor = jnp.exp(jax.random.uniform(gain, minval=-_GAIN, maxval=_GAIN))
    taken = (1.0 - images / 255.0) @ shares
    taken = jnp.minimum(factor * taken**exponent, 1.0)
    return jnp.round(255.0 * (1.0 - taken)).astype(images.dtype)
