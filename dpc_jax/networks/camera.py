"""The camera branches: where in the frame the object is, and the focal length.

Not in the paper. The released code has both: one layer to three numbers, tanh, times
0.15, and a focal length of 2 plus a sigmoid, which cannot reach the true 1.875.
"""

import flax.linen as nn
import jax

from dpc_jax.networks.encoder import conv_init, leaky_relu

# Half of the ranges that the heads can reach; the data sets stay within.
TRANSLATION_RANGE = 0.15  # box diagonals, each axis
FOCAL_RANGE = 0.3  # share of the config's focal length


class BoundedHead(nn.Module):
    """Small numbers around 0 of an image: a hidden layer, a linear one, tanh.

    Attributes:
      outputs: how many numbers. bound: what their size stays below.
      width: of the hidden layer.
    """

    outputs: int
    bound: float
    width: int = 32

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to [B, outputs] in (-bound, bound), at first near 0."""
        x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(features))
        x = nn.Dense(self.outputs, kernel_init=nn.initializers.normal(0.05))(x)
        return self.bound * nn.tanh(x)
