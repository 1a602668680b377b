"""The basic method: every point its own Gaussian, sampled at every cell it reaches.

Appendix "Differentiable point cloud projection", the basic implementation. Exact to
rounding: no position is rounded to a cell, and every point has a size of its own.
"""

import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import kernels
from dpc_jax.render.exact import tiles

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
    rows, cols, depth = (
        kernels.sample_axis(coordinates[:, axis], sigma, shape[axis])
        for axis in range(3)
    )
    reach = kernels.find_reach(sigma, coordinates.dtype)
    places = _Places(coordinates[:, :2], jnp.where(is_inside, reach**2, -1))
    points = tiles.Points({"values": values, "depth": depth}, rows, cols)
    call = functools.partial(tiles.sum_in_tiles, _sum_separable, _is_reached)
    return call(shape, _CHUNK, points, places)


class _Places(NamedTuple):
    """Row and column of points [N, 2]; their squared reach [N], -1 where outside."""

    centers: chex.Array
    squared_reaches: chex.Array


def _is_reached(places, corner):
    """Whether a tile meets the circle beyond which a point's density is negligible."""
    down, across = (
        tiles.find_gap(places.centers[:, axis], corner[axis]) for axis in range(2)
    )
    return down**2 + across**2 <= places.squared_reaches


@jax.custom_vjp
def _sum_separable(points, corner):
    """Two matrix products: the pixels' weights, then those along the rays."""
    return _sum_forward(points, corner)[0]


def _sum_forward(points, corner):
    values, depth = points.whole["values"], points.whole["depth"]
    rows, cols = _spread_weights(points)
    summed = _multiply(_weigh_pixels(values, rows * cols).T, depth)
    shape = values.shape[1], tiles.SIDE, tiles.SIDE, depth.shape[1]
    return summed.reshape(shape), (points, corner)


def _sum_backward(residuals, cotangent):
    # Autodiff's, but with the cotangent transposed instead of all the points' weights,
    # and with sums over few numbers as products with zeros and ones: as reductions
    # they took as long as the products (on a CPU; a fifth less in all).
    points, _ = residuals
    values, depth = points.whole["values"], points.whole["depth"]
    rows, cols = _spread_weights(points)
    cotangent = cotangent.reshape(-1, depth.shape[1])
    slopes = _multiply(depth, cotangent.T).reshape(*values.shape, -1)
    slope = jnp.einsum("nv,nvp->np", values, slopes, precision="highest")
    weights = rows * cols
    ones = jnp.ones(weights.shape[1], weights.dtype)
    whole = {
        "values": _multiply(slopes * weights[:, None], ones),
        "depth": _multiply(_weigh_pixels(values, weights), cotangent),
    }
    of_row, of_col = _list_places(weights.dtype)
    by_row, by_col = (
        _multiply(slope * cols, of_row.T),
        _multiply(slope * rows, of_col.T),
    )
    return tiles.Points(whole, by_row, by_col), None


_sum_separable.defvjp(_sum_forward, _sum_backward)


def _weigh_pixels(values, weights):
    """Each point's mass on each pixel of a tile, for each channel, [N, V·SIDE²]."""
    return (values[:, :, None] * weights[:, None]).reshape(len(values), -1)


def _spread_weights(points):
    """Weights of the row and of the column of each pixel of a tile, both [N, SIDE²]."""
    full = (len(points.by_row), tiles.SIDE, tiles.SIDE)
    rows = jnp.broadcast_to(points.by_row[:, :, None], full)
    cols = jnp.broadcast_to(points.by_col[:, None, :], full)
    return rows.reshape(-1, tiles.SIDE**2), cols.reshape(-1, tiles.SIDE**2)


def _list_places(dtype):
    """Which pixels of a tile are in a row, and in a column; both [SIDE, SIDE²]."""
    one, all_ones = jnp.eye(tiles.SIDE, dtype=dtype), jnp.ones((1, tiles.SIDE), dtype)
    return jnp.kron(one, all_ones), jnp.kron(all_ones, one)


def _multiply(left, right):
    return jnp.matmul(left, right, precision="highest")
