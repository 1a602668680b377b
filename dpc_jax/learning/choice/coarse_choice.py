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


def place_candidates(points: jax.Array, view: View) -> tuple[jax.Array, jax.Array]:
    """Where points [N, 3] are in the image, seen from each candidate's pose.

    Apart from `compute_image_losses`, so that a batch can project the points of all
    views side by side and then take one view after the other: in a loop, XLA would
    project each point again for every pixel of its row and column.

    Returns:
      (rows, columns), [C, N] continuous index each.
    """

    def place(candidate):
        moved = to_camera_frame(points, candidate, view.translation)
        grid = VoxelGrid(view.side)
        found, is_inside = to_grid(moved, camera=view.camera, grid=grid)
        rows, cols, _ = found.T
        return [jnp.where(is_inside, axis, _OUTSIDE) for axis in (rows, cols)]

    rows, cols = jax.vmap(place)(view.rotation)
    return rows, cols


def compute_image_losses(
    places: tuple[jax.Array, jax.Array],
    mass: jax.Array,
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
      places: of `place_candidates`, in an image of side D.
      mass: () of each point. sigma: (). Both in voxels of a grid of side D.
      target: [D, D] silhouette.
    """
    pixels = jnp.arange(target.shape[0], dtype=target.dtype)

    def weigh(centers):
        away = jnp.abs(centers[:, None, :] - pixels[None, :, None])
        return jnp.where(away < 1, 1 - away, 0)

    pairs = (((2,), (2,)), ((0,), (0,)))
    depth = jax.lax.dot_general(*map(weigh, places), pairs)
    distances = jnp.abs(pixels[:, None] - pixels[None])
    kernel = sample_gaussian(distances, jnp.asarray(sigma))
    for _ in range(2):
        depth = jnp.swapaxes(jnp.matmul(depth, kernel), 1, 2)
    silhouettes = 1 - jnp.exp(-jnp.asarray(mass) * depth)
    return jnp.sum((silhouettes - target[None]) ** 2, axis=(1, 2))
