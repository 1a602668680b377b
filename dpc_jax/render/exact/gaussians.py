"""The basic method: every point its own Gaussian, sampled at every cell it reaches.

Appendix "Differentiable point cloud projection", the basic implementation. Exact to
rounding: no position is rounded to a cell, and every point may have its own size.
"""

import functools

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from dpc_jax.render import kernels
from dpc_jax.render.exact import tiles

_CHUNK = 256
_multiply = functools.partial(jnp.matmul, precision="highest")


def sum_gaussians(
    coordinates: jax.Array,
    values: jax.Array,
    sigma: jax.Array,
    *,
    shape: tuple[int, int, int],
    is_inside: ArrayLike = True,
) -> jax.Array:
    """Eq. 7 of the paper: isotropic Gaussians G_n at every cell, and their sum.

    Each is the product of its factors along the three axes, v_n·a_n ⊗ b_n ⊗ c_n. They
    are normalised, so that a point adds its mass v_n; the paper's G_n has height 1.

    Values are [N, V] (mass, and mass times each colour channel), sigma is () or [N],
    the result [V, rows, cols, depth]. A point of mass zero may not be left out by
    `is_inside`, because its mass has a gradient.
    """
    count = coordinates.shape[0]
    if count == 0:
        return jnp.zeros((values.shape[1], *shape), values.dtype)
    sigma = jnp.broadcast_to(sigma, (count,))
    # The backward pass samples the weights again. That is cheap, whereas keeping N·3D
    # of them for every sample of a batch would fill the memory.
    call = jax.checkpoint(functools.partial(_sum_sampled, shape=shape))
    return call(coordinates, values, sigma, is_inside)


def _sum_sampled(coordinates, values, sigma, is_inside, *, shape):
    rows, cols, depth = (
        kernels.sample_axis(coordinates[:, axis], sigma, shape[axis])
        for axis in range(3)
    )
    reach = kernels.find_reach(sigma, coordinates.dtype)
    # No circle has the squared radius -1.
    places = coordinates[:, :2], jnp.where(is_inside, reach**2, -1)
    points = tiles.Points({"values": values, "depth": depth}, rows, cols)
    return tiles.sum_in_tiles(
        _sum_separable, _is_reached, shape, _CHUNK, points, places
    )


def _is_reached(places, corner):
    """Whether a tile meets the circle beyond which a point's density is negligible."""
    centers, squared_reach = places
    down, across = tiles.find_gaps(centers, corner)
    return down**2 + across**2 <= squared_reach


@jax.custom_vjp
def _sum_separable(points, corner):
    """Two matrix products: the pixels' weights, then those along the rays."""
    return _sum_forward(points, corner)[0]


def _sum_forward(points, corner):
    values, depth = points.whole["values"], points.whole["depth"]
    rows, cols = _spread_weights(points)
    summed = _multiply(_weigh_pixels(values, rows * cols).T, depth)
    return summed.reshape(-1, tiles.SIDE, tiles.SIDE, depth.shape[1]), (points, corner)


def _sum_backward(residuals, cotangent):
    # What autodiff would do, a fifth faster on a CPU: the cotangent is transposed
    # instead of the weights of all points, and sums over few numbers are products with
    # zeros and ones, because as reductions they took as long as the products.
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
    # Which pixels of a tile are in a row, and in a column; both [SIDE, SIDE²].
    line = jnp.ones((1, tiles.SIDE), ones.dtype)
    one = jnp.eye(tiles.SIDE, dtype=ones.dtype)
    by_row = _multiply(slope * cols, jnp.kron(one, line).T)
    by_col = _multiply(slope * rows, jnp.kron(line, one).T)
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
