"""The shape branch: features to a point cloud, its colours and its points' scale."""

import chex
import flax.linen as nn

from dpc_jax.networks.encoder import conv_init, leaky_relu

_OUTPUT_INIT = nn.initializers.truncated_normal(0.025)


class ShapeHead(nn.Module):
    """An MLP with one hidden layer (§ Network architecture).

    Attributes:
      num_points: N.
      hidden: width of the hidden layer.
      has_color: predict colours too; without, there are no parameters for them.
    """

    num_points: int
    hidden: int = 1024
    has_color: bool = False

    @nn.compact
    def __call__(self, features: chex.Array) -> dict[str, chex.Array]:
        """Features [B, F] to points, occupancy scale and colours.

        Returns:
          points [B, N, 3] in [-1/2, 1/2]; scale [B] in (0, 1), the learned scaling
          coefficient; colors [B, N, 3] in (0, 1) where asked for.
        """
        x = leaky_relu(nn.Dense(self.hidden, kernel_init=conv_init)(features))
        batch = features.shape[0]
        points = nn.Dense(3 * self.num_points, kernel_init=_OUTPUT_INIT, name="points")
        shape = {
            "points": nn.tanh(points(x)).reshape(batch, self.num_points, 3) / 2,
            "scale": nn.sigmoid(nn.Dense(1, kernel_init=_OUTPUT_INIT, name="scale")(x))[
                :, 0
            ],
        }
        if self.has_color:
            colors = nn.Dense(
                3 * self.num_points, kernel_init=_OUTPUT_INIT, name="colors"
            )
            shape["colors"] = nn.sigmoid(colors(x)).reshape(batch, self.num_points, 3)
        return shape
