"""The image encoder of § Network architecture: convolutions, two dense layers.

Leaky ReLU with slope 0.2 after every layer.

`measure_tint`, not in the paper, gives the mean colour of an image's object: what its
points' colours begin from. Features of the encoder differ between objects by a tenth of
their size, so that layers behind them learn the category's mean colours long before
those of an object (docs/log.md). The mean colour needs no learning.
"""

import functools

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp

_SMALLEST_IMAGE = 16  # pixels: one stride to 8, one block to 4
TINT = 3  # numbers of an image
_WHITE = 0.97  # of a tint: from which on all channels are the background
_BOUND = 0.02  # colours nearer to 0 or 1 than this count as if they were not

leaky_relu = functools.partial(nn.leaky_relu, negative_slope=0.2)
# Keeps the variance through a leaky ReLU of slope 0.2 (He et al., 2015).
conv_init = nn.initializers.variance_scaling(2 / (1 + 0.2**2), "fan_in", "normal")


def _count_blocks(image_size):
    """Number of two-convolution blocks that bring an image down to 4×4 pixels."""
    is_power = image_size & (image_size - 1) == 0
    if image_size < _SMALLEST_IMAGE or not is_power:
        raise ValueError(
            f"The image size must be a power of two of at least {_SMALLEST_IMAGE} "
            "pixels, because the encoder halves it down to 4, but it is "
            f"{image_size}; use for example 64."
        )
    return image_size.bit_length() - 1 - 3


def activate(x: jax.Array, *, normalize: bool) -> jax.Array:
    """Leaky ReLU of features [B, ...], before it those of each sample normalised."""
    if normalize:
        # The fast variance E[x²] - E[x]² would cancel where the mean is large.
        # The epsilon matters for a constant layer only: activations are of order 1.
        x = nn.LayerNorm(
            reduction_axes=tuple(range(1, x.ndim)),
            use_bias=False,
            use_scale=False,
            epsilon=1e-6,
            use_fast_variance=False,
        )(x)
    return leaky_relu(x)


class ImageEncoder(nn.Module):
    """Images to features.

    A strided 5×5 convolution, then blocks of a strided and a plain 3×3 convolution
    down to 4×4: at 64 pixels the paper's 7 convolutions, 4 of them strided. A call
    raises a ValueError if the size S of the images is not a power of two from 16 on.

    Attributes:
      channels: number after the first convolution; every block doubles it.
      hidden: width of the two dense layers.
      normalize: bring all features of a sample to mean 0 and variance 1 after each
        layer. Not in the paper.
      blocks: number of blocks at every S, 3 for the paper's 7 convolutions; 0 for as
        many as lead to 4×4 pixels (released code).
    """

    channels: int = 16
    hidden: int = 1024
    normalize: bool = False
    blocks: int = 0

    @nn.compact
    def __call__(self, images: jax.Array, *, mix: jax.Array | None = None) -> jax.Array:
        """Images [B, S, S, 3 or 4], in [-1, 1], to features [B, hidden].

        With the weights `mix` [M, B] they are [M, hidden], of mixtures of the images:
        row i sums the images' activations after the first dense layer by mix[i]. This
        is the latent space in which § Interpolation of shapes goes from one to another.
        """
        chex.assert_shape(images, (None, None, images.shape[1], {3, 4}))
        needed = _count_blocks(images.shape[1])
        conv = functools.partial(nn.Conv, kernel_init=conv_init)
        act = functools.partial(activate, normalize=self.normalize)
        x = act(conv(self.channels, (5, 5), strides=2)(images))
        for block in range(self.blocks or needed):
            width = self.channels * 2 ** (block + 1)
            x = act(conv(width, (3, 3), strides=2)(x))
            x = act(conv(width, (3, 3))(x))
        x = x.reshape(x.shape[0], -1)
        x = act(nn.Dense(self.hidden, kernel_init=conv_init)(x))
        if mix is not None:
            x = jnp.matmul(mix, x, precision="highest")
        return act(nn.Dense(self.hidden, kernel_init=conv_init)(x))


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
