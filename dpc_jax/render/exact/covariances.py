"""Full covariances: carried into the grid, factored, and summed (basic method).

Eq. "density" of the paper has a covariance Σ_i for every point; its experiments use
isotropic ones. Here each is carried through rotation and local perspective, and its
density is sampled axis by axis: the first axis by its marginal, the next by its
conditional on the cell of the first, the last on the cells of both. Each of these is a
one-dimensional Gaussian, normalised over the unbounded grid, so a point's mass is exact
for every covariance, singular ones too.
"""

import functools
import itertools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import kernels
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.exact import tiles

_CHUNK = 32
_ORDERS = tuple(itertools.permutations(range(3)))


class Factors(NamedTuple):
    """Gaussians as conditionals, x₁, then x₂ | x₁, then x₃ | x₁, x₂.

    Attributes:
      sigmas: [N, 3] standard deviations of the three, in voxels.
      slopes: [N, 3] of x₂ over x₁, of x₃ over x₁, and of x₃ over what x₁ leaves of x₂.
    """

    sigmas: chex.Array
    slopes: chex.Array


def move_covariance(
    covariance: chex.Array,
    points: chex.Array,
    matrix: chex.Array,
    *,
    camera: Camera,
    grid: VoxelGrid,
) -> chex.Array:
    """Covariances in the grid: S·J·R·Σ·Rᵀ·Jᵀ·S. J is the perspective's derivative.

    Approximation: over the width of a point perspective is taken as linear (as in EWA
    splatting); docs/equations.md has the error measured. Rotation and orthographic
    projection are exact.

    Args:
      covariance: [N, 3, 3], object frame, in squares of extent / rows.
      points: [N, 3], camera frame, all before the camera.
      matrix: [3, 3] rotation, object to camera.

    Returns:
      [N, 3, 3], axes (row, col, depth), voxels².
    """
    x, y, z = points.T
    one, zero = jnp.ones_like(z), jnp.zeros_like(z)
    if camera.projection == "perspective":
        focal = jnp.asarray(camera.focal_length, z.dtype)
        zoom = focal / z
        down, across = -focal * (y / z) / z, -focal * (x / z) / z
    else:
        zoom, down, across = one, zero, zero
    jacobian = jnp.stack(
        [
            jnp.stack([zero, zoom, down], axis=-1),  # row, from v
            jnp.stack([zoom, zero, across], axis=-1),  # col, from u
            jnp.stack([zero, zero, one], axis=-1),
        ],
        axis=-2,
    )
    sizes = jnp.array(grid.shape, z.dtype) / grid.shape[0]
    linear = sizes[:, None] * jnp.matmul(jacobian, matrix, precision="highest")
    symmetric = (covariance + jnp.swapaxes(covariance, 1, 2)) / 2
    return jnp.einsum(
        "nij,njk,nlk->nil", linear, symmetric, linear, precision="highest"
    )


def choose_order(covariance: chex.Array) -> chex.Array:
    """Which of the six orders of axes to factor each covariance [N, 3, 3] in; [N].

    The widest axis first, then the wider of what is left, as pivoting does: all slopes
    are then at most one, and no cell is further than half a voxel from where a thin
    Gaussian passes.
    """
    candidates = []
    for order in _ORDERS:
        first, second, third = order
        variance = covariance[:, first, first]
        rest = [
            covariance[:, i, i]
            - _divide(covariance[:, i, first] ** 2, variance, jnp.zeros_like(variance))
            for i in (second, third)
        ]
        is_first = jnp.all(variance[:, None] >= jnp.diagonal(covariance, 0, 1, 2), 1)
        candidates.append(is_first & (rest[0] >= rest[1]))
    return jnp.argmax(jnp.stack(candidates), axis=0)  # of equal ones, the first


def factor_covariance(covariance: chex.Array) -> Factors:
    """Conditionals of covariances [N, 3, 3], in the order of their axes.

    What rounding makes of a singular covariance, and a variance below zero, count as
    zero; then the conditional lies on the nearest cell.
    """
    a, b, c = range(3)
    entry = lambda i, j: covariance[:, i, j]  # noqa: E731
    first = entry(a, a)
    zero = jnp.zeros_like(first)
    slope_b = _find_slope(entry(b, a), first, zero)
    slope_c = _find_slope(entry(c, a), first, zero)
    second = entry(b, b) - slope_b * entry(b, a)
    # Below the rounding of what was subtracted nothing is known of it.
    noise = 8 * jnp.finfo(first.dtype).eps * jnp.abs(first)
    shared = entry(c, b) - slope_c * entry(b, a)
    slope_e = _find_slope(shared, second, noise)
    third = entry(c, c) - slope_c * entry(c, a) - slope_e * shared
    return Factors(
        jnp.stack([_take_root(v) for v in (first, second, third)], axis=-1),
        jnp.stack([slope_b, slope_c, slope_e], axis=-1),
    )


def sum_covariances(
    coordinates: chex.Array,
    values: chex.Array,
    covariance: chex.Array,
    *,
    shape: tuple[int, int, int],
    is_inside: chex.Array | None = None,
) -> chex.Array:
    """Density of Gaussians with covariances [N, 3, 3]; else as `sum_gaussians`."""
    if coordinates.shape[0] == 0:
        return jnp.zeros((values.shape[1], *shape), values.dtype)
    chosen = choose_order(jax.lax.stop_gradient(covariance))
    if is_inside is None:
        is_inside = jnp.ones(coordinates.shape[0], bool)
    side, dtype = max(shape), covariance.dtype

    def add_order(total, i):
        # All orders run one program, so the volume is a cube until the end; tiles that
        # no point reaches cost nothing.
        order = jnp.array(_ORDERS)[i]
        is_mine = is_inside & (chosen == i)
        # In another order slopes may be anything, and zero times the infinity of their
        # derivative would be NaN.
        safe = jnp.where(is_mine[:, None, None], covariance, jnp.eye(3, dtype=dtype))
        part = _sum_in_order(
            coordinates[:, order],
            values,
            safe[:, order][:, :, order],
            is_mine,
            side,
        )
        turns = [
            functools.partial(
                jnp.transpose, axes=(0, *(1 + o.index(a) for a in range(3)))
            )
            for o in _ORDERS
        ]
        return total + jax.lax.switch(i, turns, part), None

    total = jnp.zeros((values.shape[1], side, side, side), values.dtype)
    total, _ = jax.lax.scan(add_order, total, jnp.arange(len(_ORDERS)))
    return total[:, : shape[0], : shape[1], : shape[2]]


def _sum_in_order(centers, values, covariance, is_inside, side):
    """The part of those points whose covariance this order of axes was chosen for."""
    factors = factor_covariance(covariance)
    reaches = kernels.find_reach(factors.sigmas, centers.dtype)
    along = reaches[:, 1] + jnp.abs(factors.slopes[:, 0]) * reaches[:, 0]
    places = _Places(centers, reaches[:, 0], along, is_inside)
    points = {"centers": centers, "values": values, "factors": factors}
    return tiles.sum_in_tiles(
        _make_density(side),
        _is_reached,
        (side, side, side),
        _CHUNK,
        tiles.Points(points, {}, {}),
        places,
    )


class _Places(NamedTuple):
    """Centres [N, 3], and how far points reach along the first and second axis, [N]."""

    centers: chex.Array
    first: chex.Array
    second: chex.Array
    is_inside: chex.Array


def _is_reached(places, corner):
    first, second = (
        tiles.find_gap(places.centers[:, axis], corner[axis]) for axis in range(2)
    )
    return places.is_inside & (first <= places.first) & (second <= places.second)


@functools.cache
def _make_density(size):
    """Density of a chunk in a tile, with `size` cells along the last axis."""

    def sum_density(points, corner):
        centers, values = points.whole["centers"], points.whole["values"]
        factors = points.whole["factors"]
        slopes = factors.slopes
        square = jnp.arange(tiles.SIDE)
        first = (corner[0] + square).astype(centers.dtype)
        second = (corner[1] + square).astype(centers.dtype)
        third = jnp.arange(size, dtype=centers.dtype)
        # [n], then [n, SIDE] and [n, SIDE, SIDE]: the means on the cells before them.
        ahead = first - centers[:, :1]
        mean_second = centers[:, 1:2] + slopes[:, :1] * ahead
        left = second - mean_second[..., None]
        mean_third = centers[:, 2:3] + slopes[:, 1:2] * ahead
        mean_third = mean_third[..., None] + slopes[:, 2, None, None] * left

        sigma = factors.sigmas
        weights = kernels.sample_gaussian(first, sigma[:, :1], center=centers[:, :1])[
            ..., None
        ] * kernels.sample_gaussian(
            second, sigma[:, 1, None, None], center=mean_second[..., None]
        )
        along = kernels.sample_gaussian(
            third, sigma[:, 2, None, None, None], center=mean_third[..., None]
        )
        return jnp.einsum(
            "nv,nrc,nrcd->vrcd", values, weights, along, precision="highest"
        )

    return sum_density


def _find_slope(shared, variance, threshold):
    """Slope of a conditional mean; zero where the variance says nothing of it.

    Of the widest axis over the others no slope exceeds one, but for rounding: one
    beyond two comes from a matrix that is no covariance. The square of the variance,
    which the derivative divides by, must not underflow.
    """
    least = jnp.sqrt(jnp.finfo(variance.dtype).tiny)
    is_safe = jnp.abs(shared) <= 2 * variance
    # Both, or the inverse square of a small variance, times a large cotangent, would be
    # infinite before it is multiplied by the zero.
    return _divide(
        jnp.where(is_safe, shared, 0),
        jnp.where(is_safe, variance, 0),
        jnp.maximum(threshold, least),
    )


def _divide(numerator, denominator, threshold):
    """Quotient, or zero where the denominator does not exceed the threshold.

    As a product with the inverse: in its derivative the numerator comes before the
    inverse square, which may be too large without it.
    """
    is_safe = denominator > threshold
    return jnp.where(is_safe, numerator * (1 / jnp.where(is_safe, denominator, 1)), 0)


def _take_root(variance):
    """Standard deviation, at least the kernels' floor; no infinite slope at zero."""
    is_wide = variance > kernels.SIGMA_FLOOR**2
    return jnp.where(
        is_wide, jnp.sqrt(jnp.where(is_wide, variance, 1)), kernels.SIGMA_FLOOR
    )
