"""The shape branch of EPCG: dense maps of points, seen from eight fixed views.

Efficient Point Cloud Generation (Lin et al., AAAI 2018) predicts, for each pixel of
each fixed view, where the surface is and whether there is any (docs/baselines.md).
"""

import math

import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import activate, conv_init
from dpc_jax.networks.viewpoints import face_object
from dpc_jax.render import quaternion

_FIRST_SIDE = 4  # pixels, of the dense layer's maps
_MOST_CHANNELS = 192
# The fixed cameras stand at the corners of a cube, upright.
AZIMUTHS = tuple(math.radians(45 + 90 * i) for i in range(4)) * 2
ELEVATIONS = (math.asin(1 / math.sqrt(3)),) * 4 + (-math.asin(1 / math.sqrt(3)),) * 4


def list_fixed_views() -> jax.Array:
    """Quaternions [8, 4] of the fixed cameras, object to camera."""
    return face_object(jnp.array(AZIMUTHS), jnp.array(ELEVATIONS))


class ViewMapHead(nn.Module):
    """A dense layer, then doublings (nearest neighbour) with a 3×3 convolution each.

    Attributes:
      side: S of the maps, a power of two from 8 on.
      focal_length, distance: of the fixed cameras.
      channels: of the largest maps; each smaller one has twice as many, 192 at most.
      normalize: see `ImageEncoder`.
    """

    side: int
    focal_length: float
    distance: float
    channels: int = 48
    normalize: bool = True

    @nn.compact
    def __call__(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to what the eight views see.

        Returns:
          "maps" [B, 8, S, S, 3]: u and v in the image plane and metric depth, each in
          its own view; "point_logits" [B, 8·S·S], above 0 where there is a surface;
          "points" [B, 8·S·S, 3], those of the maps in the object frame.
        """
        doublings = (self.side // _FIRST_SIDE).bit_length() - 1

        def count(level):
            return min(self.channels * 2**level, _MOST_CHANNELS)

        width = count(doublings)
        x = nn.Dense(width * _FIRST_SIDE**2, kernel_init=conv_init)(features)
        x = x.reshape(-1, _FIRST_SIDE, _FIRST_SIDE, width)
        for level in reversed(range(doublings)):
            x = activate(x, normalize=self.normalize)
            x = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)
            x = nn.Conv(count(level), (3, 3), kernel_init=conv_init)(x)
        x = activate(x, normalize=self.normalize)
        views = len(AZIMUTHS)
        # At first every map is a plane through the object's centre.
        init = nn.initializers.variance_scaling(0.01, "fan_in", "normal")
        x = nn.Conv(4 * views, (1, 1), kernel_init=init, name="maps")(x)
        x = x.reshape(-1, self.side, self.side, views, 4).transpose(0, 3, 1, 2, 4)
        start = make_planes(self.side, self.distance)
        maps = x[..., :3] + start[None, None]
        points = fuse_maps(maps, focal_length=self.focal_length, distance=self.distance)
        logits = x[..., 3].reshape(len(x), -1)
        return {"maps": maps, "point_logits": logits, "points": points}


def make_planes(side: int, depth: float) -> jax.Array:
    """u and v of every pixel, and a depth: [side, side, 3]."""
    axis = (jnp.arange(side) + 0.5) / side - 0.5
    v, u = jnp.meshgrid(axis, axis, indexing="ij")
    return jnp.stack([u, v, jnp.full_like(u, depth)], axis=-1)


def fuse_maps(maps: jax.Array, *, focal_length: float, distance: float) -> jax.Array:
    """The points of all fixed views in the object frame, [B, 8·S·S, 3].

    Args:
      maps: [B, 8, S, S, 3], u, v and metric depth z: the inverse of u = f·x/z, with
        z = z_rotated + distance.
    """
    depth = maps[..., 2:]
    planar = maps[..., :2] * depth / focal_length
    seen = jnp.concatenate([planar, depth - distance], axis=-1)
    turns = jax.vmap(quaternion.to_matrix)(list_fixed_views())  # object to camera
    points = jnp.einsum("bvijc,vcd->bvijd", seen, turns, precision="highest")
    return points.reshape(len(maps), -1, 3)
