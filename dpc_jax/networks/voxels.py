"""The shape branch of voxel models: features to occupancies of the object frame.

The paper compares with such models (Ours-V, PTN, DRC, MVC) and describes the decoder of
none; this one is after PTN's: a dense layer, then transposed convolutions that double
the side down to one channel (docs/baselines.md).
"""

import itertools
import math

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.networks.encoder import activate, conv_init

_FIRST_SIDE = 4  # cells, of the dense layer's volume
# The output's start. A cell of 0.05 makes a ray of 20 such cells two thirds opaque: a
# half-filled volume would be opaque to rounding, and no background pixel had a gradient
# (Tulsiani et al. start there, and their grids are carved from the edges inwards).
_FIRST_OCCUPANCY = 0.05


class VoxelHead(nn.Module):
    """A dense layer and transposed convolutions (kernel 4, stride 2).

    Attributes:
      side: of the volume, a power of two from 8 on.
      channels: of the last volume but one; each smaller volume has twice as many.
      has_color: predict colours too; otherwise there are no parameters for them.
      normalize: see `ImageEncoder`.
      is_contained: whether cells beyond the sphere of radius 1/2, in which objects of
        box diagonal 1 lie, are empty. From poses that are not known yet, the corners of
        the cube are seen in the wrong places or not at all.
    """

    side: int
    channels: int = 16
    has_color: bool = False
    normalize: bool = True
    is_contained: bool = False
    kind = "voxels"

    @nn.compact
    def __call__(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "cells" [B, D, D, D], occupancies in (0, 1).

        "colors" [B, D, D, D, 3] in (0, 1) where asked for.
        """
        doublings = (self.side // _FIRST_SIDE).bit_length() - 1
        width = self.channels * 2 ** (doublings - 1)
        x = nn.Dense(width * _FIRST_SIDE**3, kernel_init=conv_init)(features)
        x = x.reshape(-1, *[_FIRST_SIDE] * 3, width)
        for level in reversed(range(1, doublings)):
            x = activate(x, normalize=self.normalize)
            x = DoublingConv(self.channels * 2 ** (level - 1))(x)
        x = activate(x, normalize=self.normalize)
        start = math.log(_FIRST_OCCUPANCY / (1 - _FIRST_OCCUPANCY))
        cells = DoublingConv(1, stddev=0.02, name="cells")(x)[..., 0]
        shape = {"cells": nn.sigmoid(cells + start)}
        if self.is_contained:
            places = np.indices((self.side,) * 3) + 0.5 - self.side / 2
            is_inside = np.sum(places**2, axis=0) <= (self.side / 2) ** 2
            shape["cells"] = jnp.where(is_inside[None], shape["cells"], 0)
        if self.has_color:
            colors = DoublingConv(3, stddev=0.02, name="colors")(x)
            shape["colors"] = nn.sigmoid(colors)
        return shape


class DoublingConv(nn.Module):
    """A transposed 3D convolution of kernel 4, stride 2 and padding 1.

    As eight convolutions of kernel 2, one for each place that a cell of the result has
    in its cell of the input: XLA's own takes 35 times as long on a CPU, with
    its gradient (docs/baselines.md).

    Attributes:
      channels: of the result.
      stddev: of the first weights; 0 for one that keeps the variance.
    """

    channels: int
    stddev: float = 0.0

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """[B, n, n, n, C] to [B, 2n, 2n, 2n, channels]."""
        side, width = x.shape[1], x.shape[-1]
        init = conv_init
        if self.stddev:
            init = nn.initializers.truncated_normal(self.stddev)
        # Of each cell's 2×2×2 neighbourhood, for each of the 8 places. Three axes, so
        # that devices do not share it by columns, as they do large dense layers.
        kernel = self.param("kernel", init, (8, width, 8 * self.channels))
        kernel = kernel.reshape(8 * width, -1)
        bias = self.param("bias", nn.initializers.zeros, (self.channels,))
        padded = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (1, 1), (0, 0)))
        reach = side + 1
        neighbours = jnp.concatenate(
            [
                padded[:, i : i + reach, j : j + reach, k : k + reach]
                for i, j, k in itertools.product((0, 1), repeat=3)
            ],
            axis=-1,
        )
        places = jnp.matmul(neighbours, kernel)
        places = places.reshape(*places.shape[:-1], 8, self.channels)
        # Place 0 of a cell is reached by the cell before and itself, place 1 by itself
        # and the cell after.
        parts = [
            places[:, i : i + side, j : j + side, k : k + side, 4 * i + 2 * j + k]
            for i, j, k in itertools.product((0, 1), repeat=3)
        ]
        stacked = jnp.stack(parts, axis=-2).reshape(*x.shape[:-1], 2, 2, 2, -1)
        mixed = stacked.transpose(0, 1, 4, 2, 5, 3, 6, 7)
        volume = mixed.reshape(-1, *[2 * side] * 3, self.channels)
        return volume + bias.reshape(1, 1, 1, 1, -1)
