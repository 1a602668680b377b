"""The shape branch of EPCG: dense maps of points, seen from eight fixed views.

Efficient Point Cloud Generation (Lin et al., AAAI 2018) predicts, for each pixel of
each fixed view, where the surface is and whether there is any (docs/baselines.md).
"""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.networks.encoder import activate, conv_init

_FIRST_SIDE = 4  # pixels, of the dense layer's maps
# Of the largest maps; each smaller one has twice as many, up to the second number.
_CHANNELS, _MOST_CHANNELS = 48, 192
# Where the fixed cameras stand: the corners of a cube.
_CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


def list_fixed_views() -> np.ndarray:
    """Rotations [8, 3, 3] of the fixed cameras, object to camera; all are upright."""
    rotations = []
    for place in [(x, y, z) for z in (1, -1) for x, y in _CORNERS]:
        forward = -np.array(place) / np.sqrt(3)
        right = np.cross(forward, [0, 0, 1]) * np.sqrt(3 / 2)
        rotations.append([right, np.cross(forward, right), forward])
    return np.array(rotations, np.float32)


class ViewMapHead(nn.Module):
    """A dense layer, then doublings (nearest neighbour) with a 3×3 convolution each.

    Attributes:
      side: S of the maps, a power of two from 8 on.
      focal_length, distance: of the fixed cameras.
      normalize: see `ImageEncoder`.
    """

    side: int
    focal_length: float
    distance: float
    normalize: bool = True
    kind = "maps"

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
            return min(_CHANNELS * 2**level, _MOST_CHANNELS)

        width = count(doublings)
        x = nn.Dense(width * _FIRST_SIDE**2, kernel_init=conv_init)(features)
        x = x.reshape(-1, _FIRST_SIDE, _FIRST_SIDE, width)
        for level in reversed(range(doublings)):
            x = activate(x, normalize=self.normalize)
            x = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)
            x = nn.Conv(count(level), (3, 3), kernel_init=conv_init)(x)
        x = activate(x, normalize=self.normalize)
        views = 2 * len(_CORNERS)
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
    # The inverse of a rotation from the object to a camera is its transpose.
    turns = list_fixed_views()
    points = jnp.einsum("bvijc,vcd->bvijd", seen, turns, precision="highest")
    return points.reshape(len(maps), -1, 3)
