"""A first, coarse choice among pose candidates. Not in the paper.

Ranking all candidates by an image of some points, without any volume, costs a fraction
of the exact comparison, which is then made among the best few only.
"""

import jax
import jax.numpy as jnp

from dpc_jax.learning.shapes.kind import View
from dpc_jax.render import VoxelGrid
from dpc_jax.render.camera import to_camera_frame, to_grid
from dpc_jax.render.kernels import sample_gaussian

_OUTSIDE = -2.0  # a place in the image from which no pixel is reached


def compute_image_losses(
    points: jax.Array,
    mass: jax.Array,
    view: View,
    target: jax.Array,
    *,
    sigma: jax.Array,
) -> jax.Array:
    """Loss [C] of each candidate by the optical depth of its pixels alone.

    A ray that crosses the densities o_k lets Π(1 - o_k) through (Eq. 4). For small
    densities this is exp(-Σ o_k), and the sum over a ray of points that are splatted
    and smoothed in a volume is what the same gives in the image. As weights along rows
    and columns are separate, the image is a product of two matrices.

    Args:
      points: [N, 3]. view: of the candidates, in an image of side D.
      mass: () of each point. sigma: (). Both in voxels of a grid of side D.
      target: [D, D] silhouette.
    """

    def place(candidate):
        moved = to_camera_frame(points, candidate, view.translation)
        grid = VoxelGrid(view.side)
        found, is_inside = to_grid(moved, camera=view.camera, grid=grid)
        rows, cols, _ = found.T
        return [jnp.where(is_inside, axis, _OUTSIDE) for axis in (rows, cols)]

    pixels = jnp.arange(target.shape[0], dtype=target.dtype)

    def weigh(centers):
        away = jnp.abs(centers[:, None, :] - pixels[None, :, None])
        return jnp.where(away < 1, 1 - away, 0)

    # Else XLA projects each point again for every pixel of its row and column.
    places = jax.lax.optimization_barrier(jax.vmap(place)(view.rotation))
    rows, cols = map(weigh, places)
    depth = jax.lax.dot_general(rows, cols, (((2,), (2,)), ((0,), (0,))))
    distances = jnp.abs(pixels[:, None] - pixels[None])
    kernel = sample_gaussian(distances, jnp.asarray(sigma))
    for _ in range(2):
        depth = jnp.swapaxes(jnp.matmul(depth, kernel), 1, 2)
    silhouettes = 1 - jnp.exp(-jnp.asarray(mass) * depth)
    return jnp.sum((silhouettes - target[None]) ** 2, axis=(1, 2))
