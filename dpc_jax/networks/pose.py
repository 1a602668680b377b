"""The pose branches: an ensemble of K heads, the student distilled from it, cameras.

The last, where in the frame the object is and the focal length, are not in the paper.
The released code has both: one layer to three numbers, tanh, times 0.15, and a focal
length of 2 plus a sigmoid, which cannot reach the true 1.875.
"""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.networks.encoder import conv_init, leaky_relu

# Half of the ranges that the camera heads can reach; the data sets stay within.
TRANSLATION_RANGE = 0.15  # box diagonals, each axis
FOCAL_RANGE = 0.3  # share of the config's focal length


def spread_rotations(count: int) -> jax.Array:
    """`count` quaternions [count, 4] spread over SO(3), the first the identity.

    Greedy: of 4096 fixed random rotations, each is the one farthest from those before.
    """
    pool = np.random.default_rng(0).normal(size=(4096, 4))
    pool /= np.linalg.norm(pool, axis=-1, keepdims=True)
    chosen = [np.array([1.0, 0.0, 0.0, 0.0])]
    nearest = np.zeros(len(pool))
    while len(chosen) < count:
        nearest = np.maximum(nearest, np.abs(pool @ chosen[-1]))
        chosen.append(pool[np.argmin(nearest)])
    return jnp.asarray(np.stack(chosen[:count]), jnp.float32)


class _QuaternionHead(nn.Module):
    """The layers that belong to one pose predictor alone: by default 32, 32, 4 units.

    Without hidden layers of its own (the paper's naive variant), the pose is predicted
    from the shared layer.
    """

    width: int = 32
    layers: int = 2

    @nn.compact
    def __call__(self, features, initial):
        """Features [B, F] to quaternions [B, 4], near `initial` [4] before training."""
        x = features
        for _ in range(self.layers):
            x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(x))
        # At first the output is small beside `initial`, yet depends on the image.
        out = nn.Dense(
            4, kernel_init=nn.initializers.variance_scaling(0.1, "fan_in", "normal")
        )
        return initial[None] + out(x)


class PoseEnsemble(nn.Module):
    """K pose predictors behind one shared hidden layer, as one vmapped module.

    Attributes:
      num_heads: K, the number of heads.
      hidden: width of the shared layer.
      spreads: whether the heads start at rotations spread over SO(3); near zero
        otherwise, as in the paper.
      layers: hidden layers of each head, of 32 units; 0 in the naive variant.
      slope: of the leaky ReLU after the shared layer; 0 in the released code.
    """

    num_heads: int
    hidden: int = 1024
    spreads: bool = False
    layers: int = 2
    slope: float = 0.2

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to quaternions [B, K, 4] of any length."""
        x = nn.Dense(self.hidden, kernel_init=conv_init)(features)
        x = nn.leaky_relu(x, self.slope)
        heads = nn.vmap(
            _QuaternionHead,
            variable_axes={"params": 0},
            split_rngs={"params": True},
            in_axes=(None, 0),  # pyright: ignore[reportArgumentType]
            out_axes=1,
        )
        starts = jnp.zeros((self.num_heads, 4))
        if self.spreads:
            starts = spread_rotations(self.num_heads)
        return heads(layers=self.layers, name="heads")(x, starts)


class PoseStudent(nn.Module):
    """One pose predictor of the same architecture, distilled from the ensemble.

    Attributes:
      hidden, width: of its first hidden layer, and of the two after it.
      slope: of the leaky ReLU after the first one; 0 in the released code.
    """

    hidden: int = 1024
    width: int = 32
    slope: float = 0.2

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to quaternions [B, 4] of any length."""
        x = nn.Dense(self.hidden, kernel_init=conv_init)(features)
        x = nn.leaky_relu(x, self.slope)
        return _QuaternionHead(width=self.width, name="head")(x, jnp.zeros(4))


class PoseSelector(nn.Module):
    """A student that selects among the candidates instead of regressing a pose.

    Not in the paper. Between two candidates half a turn apart a regressor can only jump
    or average, whereas the candidate that a selector chooses keeps its accuracy.
    """

    num_classes: int
    hidden: int = 1024
    width: int = 32
    slope: float = 0.2

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to logits [B, num_classes]."""
        x = nn.Dense(self.hidden, kernel_init=conv_init)(features)
        x = nn.leaky_relu(x, self.slope)
        x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(x))
        return nn.Dense(self.num_classes, kernel_init=conv_init)(x)


class BoundedHead(nn.Module):
    """Small numbers around 0 of an image: a hidden layer, a linear one, tanh.

    Attributes:
      outputs: how many numbers. bound: what their size stays below.
    """

    outputs: int
    bound: float

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to [B, outputs] in (-bound, bound), at first near 0."""
        x = leaky_relu(nn.Dense(32, kernel_init=conv_init)(features))
        x = nn.Dense(self.outputs, kernel_init=nn.initializers.normal(0.05))(x)
        return self.bound * nn.tanh(x)
