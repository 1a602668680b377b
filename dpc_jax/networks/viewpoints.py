"""Pose heads that predict viewpoints of upright cameras. Not in the paper.

As Multi-view Consistency (MVC; Tulsiani et al., 2018) they are told what range
elevations have and that images are upright: a head predicts azimuth and elevation
alone. The judge is of MVC itself.
"""

import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import conv_init, leaky_relu


class ViewpointEnsemble(nn.Module):
    """K viewpoint predictors behind one hidden layer.

    Azimuths start in equal steps around the object, at the middle of the elevations;
    each head can reach all azimuths.

    Attributes:
      num_heads: K, the number of heads.
      elevations: lowest and highest, degrees.
      hidden: width of the layer. slope: of the leaky ReLU after it.
    """

    num_heads: int
    elevations: tuple[float, float]
    hidden: int = 1024
    slope: float = 0.2

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features [B, F] to unit quaternions [B, K, 4] of upright cameras."""
        x = nn.Dense(self.hidden, kernel_init=conv_init)(features)
        x = nn.leaky_relu(x, self.slope)
        init = nn.initializers.variance_scaling(0.1, "fan_in", "normal")
        x = nn.Dense(2 * self.num_heads, kernel_init=init, name="heads")(x)
        shares = nn.sigmoid(x).reshape(-1, 2, self.num_heads)
        sectors = jnp.arange(self.num_heads) / self.num_heads
        azimuths = 2 * jnp.pi * (shares[:, 0] + sectors[None])
        low, high = (jnp.deg2rad(angle) for angle in self.elevations)
        return face_object(azimuths, low + (high - low) * shares[:, 1])


class PoseJudge(nn.Module):
    """Tells predicted poses from drawn ones: layers of 10, 10 and 1 unit."""

    @nn.compact
    def __call__(self, quaternions: jax.Array) -> jax.Array:
        """Unit quaternions [n, 4] to logits [n], above 0 for poses taken as drawn."""
        x = quaternions
        for _ in range(2):
            x = leaky_relu(nn.Dense(10, kernel_init=conv_init)(x))
        return nn.Dense(1, kernel_init=conv_init)(x)[:, 0]


def face_object(azimuths: jax.Array, elevations: jax.Array) -> jax.Array:
    """Quaternions [..., 4] of upright cameras that look at the origin.

    Angles [...] are radians, and mean what they do of a data set's viewpoints: the
    camera sits at (cos el cos az, cos el sin az, sin el), the object's z is up.
    """
    # The level camera is (c + s, c + s, c - s, s - c)/2. It is then pitched about its
    # own x axis: (cos, sin, 0, 0) of half the elevation times that quaternion.
    c, s = jnp.cos(azimuths / 2) / 2, -jnp.sin(azimuths / 2) / 2
    up, side = c + s, c - s
    cos, sin = jnp.cos(elevations / 2), jnp.sin(elevations / 2)
    less, more = cos - sin, cos + sin
    return jnp.stack([less * up, more * up, more * side, -less * side], axis=-1)


def list_viewpoints(
    elevations: tuple[float, float], *, azimuths: int, rings: int
) -> jax.Array:
    """Upright cameras [azimuths·rings, 4] that look at the origin from all around.

    Args:
      elevations: lowest and highest, degrees; rings divide the range evenly.
    """
    low, high = (jnp.deg2rad(angle) for angle in elevations)
    around = 2 * jnp.pi * jnp.arange(azimuths) / azimuths
    shares = (jnp.arange(rings) + 0.5) / rings
    grid = jnp.meshgrid(around, low + (high - low) * shares)
    return face_object(*grid).reshape(-1, 4)


def read_elevations(quaternions: jax.Array) -> jax.Array:
    """Elevations [...], radians, of upright cameras [..., 4]; see `face_object`.

    Of squares: (sin el + 1)/2 is the share of the middle two, whatever the azimuth.
    """
    squares = quaternions**2 / jnp.sum(quaternions**2, axis=-1, keepdims=True)
    middle = squares[..., 1] + squares[..., 2]
    return jnp.arcsin(jnp.clip(2 * middle - 1, -1.0, 1.0))
