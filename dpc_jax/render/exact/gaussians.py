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


def _sum_separable(points, corner):
    """A matrix product of the points' masses on the tile's pixels, and their depths."""
    del corner
    values, depth = points.whole["values"], points.whole["depth"]
    weights = points.by_row[:, :, None] * points.by_col[:, None]
    masses = values[:, :, None, None] * weights[:, None]
    summed = _multiply(masses.reshape(len(values), -1).T, depth)
    return summed.reshape(-1, tiles.SIDE, tiles.SIDE, depth.shape[1])
