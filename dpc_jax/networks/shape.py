"""The shape branch: features to a point cloud, its colours and its points' scale."""

import functools

import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import conv_init, leaky_relu


class ShapeHead(nn.Module):
    """An MLP with one hidden layer (§ Network architecture).

    Attributes:
      num_points: N.
      hidden: width of the hidden layer.
      has_color: predict colours too; otherwise there are no parameters for them.
      scale_fixed: the scale of every object; 0: it is learned.
    """

    num_points: int
    hidden: int = 1024
    has_color: bool = False
    scale_fixed: float = 0.0

    @nn.compact
    def __call__(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to points, occupancy scale and colours.

        Returns:
          points [B, N, 3] in [-1/2, 1/2]; scale [B], the scaling coefficient, in
          (0, 1) where it is learned; colors [B, N, 3] in (0, 1) where asked for.
        """
        x = leaky_relu(nn.Dense(self.hidden, kernel_init=conv_init)(features))
        init = nn.initializers.truncated_normal(0.025)
        output = functools.partial(nn.Dense, kernel_init=init)
        size = (features.shape[0], self.num_points, 3)
        points = output(3 * self.num_points, name="points")(x)
        shape = {"points": nn.tanh(points).reshape(size) / 2}
        if self.scale_fixed:
            shape["scale"] = jnp.full(size[0], self.scale_fixed, points.dtype)
        else:
            shape["scale"] = nn.sigmoid(output(1, name="scale")(x))[:, 0]
        if self.has_color:
            colors = output(3 * self.num_points, name="colors")(x)
            shape["colors"] = nn.sigmoid(colors).reshape(size)
        return shape
