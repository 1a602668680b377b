"""The basic method: every point its own Gaussian, sampled at every cell it reaches.

Appendix "Differentiable point cloud projection", the basic implementation. Exact to
rounding: no position is rounded to a cell, and every point has a size of its own.
"""

import functools

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import kernels, tiles

_CHUNK = 256


def sum_gaussians(
    coordinates: chex.Array,
    values: chex.Array,
    sigma: chex.Array,
    *,
    shape: tuple[int, int, int],
    is_inside: chex.Array | None = None,
) -> chex.Array:
    """Density of isotropic Gaussians, Σ_n v_n·a_n ⊗ b_n ⊗ c_n.

    Args:
      coordinates: [N, 3] continuous (row, col, depth) index.
      values: [N, V], mass of a point, and mass times each colour channel.
      sigma: () or [N], standard deviation in voxels, >= 0.
      shape: (rows, cols, depth), static.
      is_inside: [N] bool, the points that count; None for all. The others cost
        nothing. A point of mass zero counts: its mass has a gradient.

    Returns:
      [V, rows, cols, depth].
    """
    count = coordinates.shape[0]
    if count == 0:
        return jnp.zeros((values.shape[1], *shape), values.dtype)
    sigma = jnp.broadcast_to(sigma, (count,))
    # The weights are sampled again for the backward pass: they are cheap, and N·3D of
    # them for every sample in flight is what would fill the memory.
    call = jax.checkpoint(functools.partial(_sum_sampled, shape=shape))
    if is_inside is None:
        is_inside = jnp.ones(count, bool)
    return call(coordinates, values, sigma, is_inside)


def _sum_sampled(coordinates, values, sigma, is_inside, *, shape):
    def sample(axis):
        cells = jnp.arange(shape[axis], dtype=coordinates.dtype)
        center, width = coordinates[:, axis, None], sigma[:, None]
        weights = kernels.sample_gaussian(cells, width, center=center)
        return kernels.cut_negligible(weights, cells, width, center=center)

    rows, cols, depth = (sample(axis) for axis in range(3))
    reach = kernels.find_reach(sigma, coordinates.dtype)
    intervals = find_intervals(coordinates, (reach, reach), is_inside)
    points = tiles.Points({"values": values, "depth": depth}, rows, cols)
    return tiles.sum_in_tiles(_sum_separable, shape, _CHUNK, points, intervals)


def find_intervals(coordinates, reaches, is_inside):
    """First and last row and column a point reaches, [N, 4]; none where outside."""
    row, col = coordinates[:, 0], coordinates[:, 1]
    down, across = reaches
    nowhere = jnp.asarray(-jnp.inf, coordinates.dtype)
    return jnp.stack(
        [
            row - down,
            jnp.where(is_inside, row + down, nowhere),
            col - across,
            jnp.where(is_inside, col + across, nowhere),
        ],
        axis=-1,
    )


def _sum_separable(points, corner):
    """Two matrix products: the pixels' weights, then those along the rays."""
    del corner
    values, depth = points.whole["values"], points.whole["depth"]
    pixels = points.by_row[:, :, None] * points.by_col[:, None, :]
    pixels = values[:, :, None, None] * pixels[:, None]
    count = values.shape[0]
    summed = jnp.matmul(pixels.reshape(count, -1).T, depth, precision="highest")
    return summed.reshape(*pixels.shape[1:], -1)
