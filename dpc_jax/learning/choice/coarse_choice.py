"""A first, coarse choice among pose candidates. Not in the paper.

Ranking all candidates by an image of some points, without any volume, costs a fraction
of the exact comparison, which is then made among the best few only.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning import point_sizes
from dpc_jax.learning.shapes.kind import View
from dpc_jax.render import VoxelGrid
from dpc_jax.render.camera import to_camera_frame, to_grid
from dpc_jax.render.kernels import sample_gaussian

_OUTSIDE = -2.0  # a place in the image from which no pixel is reached


class ImagePoints(NamedTuple):
    """Where the points of a view are in the image, for each candidate.

    Attributes:
      rows, cols: [C, n] continuous index.
      share: () how many points each of these stands for.
      sigmas: standard deviations along rows and along columns, [C, n] each, in voxels
        of the target's grid, where points have sizes of their own.
    """

    rows: jax.Array
    cols: jax.Array
    share: jax.Array
    sigmas: tuple[jax.Array, jax.Array] | None = None


def place_candidates(
    points: jax.Array,
    view: View,
    *,
    choice_points: int,
    size: jax.Array,
) -> ImagePoints:
    """Project the first `choice_points` points (0: all) from each candidate's pose.

    Apart from `compute_image_losses`, so that a batch can project the points of all
    views side by side and then take one view after the other: in a loop, XLA would
    project each point again for every pixel of its row and column.

    Args:
      points: [N, 3]. view: of the candidates.
      size: see `point_sizes`; read where each point has its own.
    """
    count = min(choice_points or len(points), len(points))
    camera = view.camera
    own = size[:count] if point_sizes.has_own_sizes(size) else None

    def place(candidate):
        moved = to_camera_frame(points[:count], candidate, view.translation)
        found, is_inside = to_grid(moved, camera=camera, grid=VoxelGrid(view.side))
        rows, cols, _ = found.T
        places = [jnp.where(is_inside, axis, _OUTSIDE) for axis in (rows, cols)]
        if own is None:
            return *places, None
        ahead = jnp.where(is_inside, camera.find_depths(moved), 1)
        zoom = jnp.asarray(camera.focal_length) / ahead
        return *places, point_sizes.find_image_sigmas(own, candidate, zoom)

    rows, cols, sigmas = jax.vmap(place)(view.rotation)
    share = jnp.asarray(points.shape[0] / count, rows.dtype)
    return ImagePoints(rows, cols, share, sigmas)


def compute_image_losses(
    places: ImagePoints,
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
      places: of the points, in an image of side D.
      mass: () of each of all points, sigma: (), both in voxels of a grid of side D.
        Points with sizes of their own have masses [N], and their places have the sizes.
      target: [D, D] silhouette.
    """

    def compare(depths):
        silhouettes = 1 - jnp.exp(-depths)
        return jnp.sum((silhouettes - target[None]) ** 2, axis=(1, 2))

    if places.sigmas is not None:
        return compare(_sum_own_sizes(places, mass, target))
    pixels = jnp.arange(target.shape[0], dtype=target.dtype)

    def weigh(centers):
        away = jnp.abs(centers[:, None, :] - pixels[None, :, None])
        return jnp.where(away < 1, 1 - away, 0)

    multiply = jax.lax.dot_general
    pairs = (((2,), (2,)), ((0,), (0,)))
    depth = multiply(weigh(places.rows), weigh(places.cols), pairs)
    distances = jnp.abs(pixels[:, None] - pixels[None])
    kernel = sample_gaussian(distances, jnp.asarray(sigma))
    for _ in range(2):
        depth = jnp.swapaxes(jnp.matmul(depth, kernel), 1, 2)
    return compare(jnp.asarray(mass * places.share) * depth)


def _sum_own_sizes(places, mass, target):
    """Optical depths [C, D, D] of Gaussians with sizes of their own."""
    assert places.sigmas is not None
    mass = mass[: places.rows.shape[1]] if mass.ndim else mass
    pixels = jnp.arange(target.shape[0], dtype=target.dtype)[None, :, None]

    def weigh(centers, sigmas):
        weights = sample_gaussian(
            pixels, sigmas[:, None, :], center=centers[:, None, :]
        )
        return jnp.where(centers[:, None, :] == _OUTSIDE, 0, weights)

    rows, cols = map(weigh, (places.rows, places.cols), places.sigmas)
    rows = rows * (mass * places.share)[None, None]
    return jnp.einsum("crn,csn->crs", rows, cols)
