"""The shape branch: features to a point cloud, its colours, its points' scale and size.

Sizes are learned where a run asks for them (appendix "Towards part-based models").
"""

import functools
import math

import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import conv_init, leaky_relu

# Standard deviations between these, as shares of the volume's side. The paper's
# schedule ends at the smaller one: at 32 voxels a tenth of one, which no render tells
# from a point. A Gaussian of the larger one spans an object of box diagonal 1.
SMALLEST_SIZE, LARGEST_SIZE = 0.003, 0.3


class ShapeHead(nn.Module):
    """An MLP with one hidden layer (§ Network architecture).

    Attributes:
      num_points: N.
      hidden: width of the hidden layer.
      has_color: predict colours too; otherwise there are no parameters for them.
      scale_fixed: the scale of every object; 0: it is learned.
      point_size: what is predicted of each point's size: "", which has no parameters,
        "sigma" or "covariance".
      first_size: standard deviation that all sizes are near before training, a share of
        the volume's side.
    """

    num_points: int
    hidden: int = 1024
    has_color: bool = False
    scale_fixed: float = 0.0
    point_size: str = ""
    first_size: float = 0.05
    kind = "points"

    @nn.compact
    def __call__(
        self, features: jax.Array, tint: jax.Array | None = None
    ) -> dict[str, jax.Array]:
        """Features [B, F] to points, occupancy scale, colours and sizes.

        A point takes of the tint [B, 3], logits of an image's colour, a share of its
        own, which all objects have in common: paint has more of it than tyres.

        Returns:
          points [B, N, 3] in [-1/2, 1/2]; scale [B], the scaling coefficient, in
          (0, 1) where it is learned; colors [B, N, 3] in (0, 1) where asked for. With
          the point size "sigma" sizes [B, N, 1], with "covariance" sizes [B, N, 3]
          along the axes of each point and turns [B, N, 4], the quaternion of any length
          that turns these axes to the object's.
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
            colors = output(3 * self.num_points, name="colors")(x).reshape(size)
            if tint is not None:
                start = nn.initializers.constant(0.5)
                shares = self.param("tint", start, (1, self.num_points, 1))
                colors += shares * tint[:, None]
            shape["colors"] = nn.sigmoid(colors)
        if self.point_size:
            shape |= self._predict_sizes(x)
        return shape

    def _predict_sizes(self, x):
        """Sizes, and with full covariances the turns of their axes.

        At first the outputs are small beside the start, yet depend on the image: the
        three sizes of a point must differ for its turn to have a gradient.
        """
        init = nn.initializers.truncated_normal(0.005)
        output = functools.partial(nn.Dense, kernel_init=init)
        rows = (*x.shape[:1], self.num_points, -1)
        is_full = self.point_size == "covariance"
        widths = output((3 if is_full else 1) * self.num_points, name="sizes")(x)
        sizes = {"sizes": bound_sizes(widths, first=self.first_size).reshape(rows)}
        if is_full:
            turns = output(4 * self.num_points, name="turns")(x).reshape(rows)
            sizes["turns"] = turns.at[..., 0].add(1)
        return sizes


def bound_sizes(outputs: jax.Array, *, first: float) -> jax.Array:
    """Standard deviations between `SMALLEST_SIZE` and `LARGEST_SIZE`.

    Their logarithm is a sigmoid of the network's output. So they are positive, a step
    of the optimiser changes a small one and a large one by about the same factor, and
    neither vanishes nor grows without limit, where a render gives no gradient.

    Args:
      outputs: of the network, any shape.
      first: what an output of zero stands for; moved inside the bounds.
    """
    ratio = math.log(LARGEST_SIZE / SMALLEST_SIZE)
    # At a bound itself the sigmoid would be flat.
    share = math.log(max(first, SMALLEST_SIZE) / SMALLEST_SIZE) / ratio
    share = min(max(share, 0.05), 0.95)
    start = math.log(share / (1 - share))
    return SMALLEST_SIZE * jnp.exp(ratio * nn.sigmoid(outputs + start))
