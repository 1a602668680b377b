"""The pose branches: an ensemble of K heads and the student distilled from it."""

import chex
import flax.linen as nn
import jax.numpy as jnp
import numpy as np

from dpc_jax.networks.encoder import conv_init, leaky_relu


def spread_rotations(count: int) -> chex.Array:
    """`count` quaternions [count, 4] spread over SO(3), the first the identity.

    Greedy: each is, of 4096 fixed random rotations, the one farthest from those before.
    """
    pool = np.random.default_rng(0).normal(size=(4096, 4))
    pool /= np.linalg.norm(pool, axis=-1, keepdims=True)
    chosen = [np.array([1.0, 0.0, 0.0, 0.0])]
    nearest = np.zeros(len(pool))
    while len(chosen) < count:
        nearest = np.maximum(nearest, np.abs(pool @ chosen[-1]))
        chosen.append(pool[np.argmin(nearest)])
    return jnp.asarray(np.stack(chosen[:count]), jnp.float32)


def surround_object(count: int) -> chex.Array:
    """`count` quaternions [count, 4] of level cameras around an upright object.

    At elevation 0 and equal steps of azimuth: z of the object up, y of the camera down.
    """
    # Half angles: azimuth 0 looks along -x, with +y of the object on the right.
    half = np.pi * np.arange(count) / count
    w, x, y, z = 0.5, 0.5, 0.5, -0.5
    cosine, sine = np.cos(half), -np.sin(half)
    # level ⊗ (cos, 0, 0, sin): turn the object about its own z first.
    turned = np.stack(
        [
            w * cosine - z * sine,
            x * cosine + y * sine,
            y * cosine - x * sine,
            z * cosine + w * sine,
        ],
        axis=-1,
    )
    return jnp.asarray(turned, jnp.float32)


class QuaternionHead(nn.Module):
    """Layers of 32, 32 and 4 units that one pose predictor has for its own.

    Attributes:
      width: of the two hidden layers.
    """

    width: int = 32

    @nn.compact
    def __call__(self, features: chex.Array, initial: chex.Array) -> chex.Array:
        """Features [B, F] to quaternions [B, 4], near `initial` [4] before training."""
        x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(features))
        x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(x))
        # The output is of the order of `initial`: small beside it, yet not constant.
        out = nn.Dense(
            4, kernel_init=nn.initializers.variance_scaling(0.1, "fan_in", "normal")
        )
        return initial + out(x)


class PoseEnsemble(nn.Module):
    """K pose predictors behind one shared hidden layer, as one vmapped module.

    Attributes:
      num_candidates: K.
      hidden: width of the shared layer.
      spread: where the heads start. "" near zero, as in the paper; "all", rotations
        spread over SO(3); "upright", level cameras around the object.
    """

    num_candidates: int
    hidden: int = 1024
    spread: str = ""

    @nn.compact
    def __call__(self, features: chex.Array) -> chex.Array:
        """Features [B, F] to quaternions [B, K, 4] of any length."""
        x = leaky_relu(nn.Dense(self.hidden, kernel_init=conv_init)(features))
        heads = nn.vmap(
            QuaternionHead,
            variable_axes={"params": 0},
            split_rngs={"params": True},
            in_axes=(None, 0),
            out_axes=1,
        )
        count = self.num_candidates
        starts = {
            "": lambda n: jnp.zeros((n, 4)),
            "all": spread_rotations,
            "upright": surround_object,
        }
        initial = starts[self.spread](count)
        return heads(name="heads")(x, initial)


class PoseStudent(nn.Module):
    """One pose predictor of the same architecture, distilled from the ensemble.

    Attributes:
      hidden: width of its hidden layer.
      width: of the layers after it; the paper's heads have 32.
    """

    hidden: int = 1024
    width: int = 32

    @nn.compact
    def __call__(self, features: chex.Array) -> chex.Array:
        """Features [B, F] to quaternions [B, 4] of any length."""
        x = leaky_relu(nn.Dense(self.hidden, kernel_init=conv_init)(features))
        return QuaternionHead(width=self.width, name="head")(x, jnp.zeros(4))


class PoseSelector(nn.Module):
    """A student that selects among the candidates instead of regressing a pose.

    Not in the paper. Between two candidates that are half a turn apart a regressor can
    only jump or average; choosing one keeps that candidate's accuracy.

    Attributes:
      num_classes: of candidates, turned ones included.
      hidden, width: of its two hidden layers.
    """

    num_classes: int
    hidden: int = 1024
    width: int = 32

    @nn.compact
    def __call__(self, features: chex.Array) -> chex.Array:
        """Features [B, F] to logits [B, num_classes]."""
        x = leaky_relu(nn.Dense(self.hidden, kernel_init=conv_init)(features))
        x = leaky_relu(nn.Dense(self.width, kernel_init=conv_init)(x))
        return nn.Dense(self.num_classes, kernel_init=conv_init)(x)
