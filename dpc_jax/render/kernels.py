"""The one-dimensional Gaussian on a grid: every method's weights along an axis.

Sampled at cell centres and normalised over the unbounded grid, so that the weights of
a point sum to one for every sigma and every position; sigma → 0 leaves the nearest
cell alone.
"""

import functools

import chex
import jax
import jax.numpy as jnp

# Below this many voxels the neighbour's share exp(-1/(2·sigma²)) of a point on a cell
# centre underflows to zero in float64 too. The floor keeps sigma = 0 and 1e-30 from
# dividing by zero; it shows only for a point within 0.02 of the middle between two
# cells, which it shares over a width of 0.02² voxels instead of none.
SIGMA_FLOOR = 0.02
# From here on the Poisson transform of the normaliser converges faster than its sum.
_WIDE = 0.5


def sample_gaussian(
    cells: chex.Array, sigma: chex.Array, *, center: chex.Numeric = 0.0
) -> chex.Array:
    """Weights exp(-(i - x)²/2σ²) / Σ_{k∈Z} exp(-(k - x)²/2σ²).

    Args:
      cells: [...], indices i, whole numbers.
      sigma: broadcastable to `cells`, standard deviation in voxels, >= 0.
      center: broadcastable to `cells`, the Gaussian's mean x as a continuous index.

    Returns:
      [...] weights, of the largest dtype among the arguments. Right to rounding for
      every sigma; no intermediate overflows.
    """
    sigma = jnp.maximum(sigma, SIGMA_FLOOR)
    # Relative to the nearest cell both exponents are <= 0, and 0 there: nothing is
    # left to cancel however narrow the kernel is. The ratio does not depend on which
    # cell that is, so its jump has no part in the derivative.
    nearest = jax.lax.stop_gradient(jnp.round(center))
    offset = center - nearest
    distance = cells - nearest
    # One quotient for all cells: in the derivative of d/σ, zero times the infinity
    # that 1/σ² is in float16 would be NaN.
    inverse = 1 / sigma
    weights = jnp.exp(-0.5 * (distance * inverse) * ((distance - 2 * offset) * inverse))
    return weights * _invert_sum(offset, sigma, inverse)


def _invert_sum(offset, sigma, inverse):
    """1 / Σ_{k∈Z} exp(-k(k - 2δ)/2σ²), of a theta function, for |δ| <= 1/2."""
    # Not minimum and maximum: at the border each would pass half of the derivative.
    is_narrow = sigma < _WIDE
    narrow = jnp.where(is_narrow, inverse, 1 / _WIDE)
    wide = jnp.where(is_narrow, 1 / _WIDE, inverse)
    direct = 1 + sum(
        jnp.exp(-0.5 * (k * narrow) * ((k - 2 * offset) * narrow))
        for k in range(-4, 5)
        if k != 0
    )
    # Beyond four voxels the waves are below 1e-137, and their exponent may overflow.
    low = jnp.where(is_narrow, _WIDE, jnp.where(sigma < 4, sigma, 4))
    wave = jnp.cos(2 * jnp.pi * offset)  # one cosine, and cos 2x and cos 3x of it
    harmonics = (wave, 2 * wave**2 - 1, (4 * wave**2 - 3) * wave)
    waves = 1 + 2 * sum(
        jnp.exp(-2 * (jnp.pi * m * low) ** 2) * harmonic
        for m, harmonic in enumerate(harmonics, 1)
    )
    root = jnp.sqrt(jnp.asarray(2 * jnp.pi, waves.dtype))
    poisson = root * jnp.exp(0.5 * (offset * wide) ** 2) * waves
    # The sum is σ times that; the product may overflow, its inverse does not.
    return jnp.where(is_narrow, 1, inverse) / jnp.where(is_narrow, direct, poisson)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def sample_axis(centers: chex.Array, sigma: chex.Array, size: int) -> chex.Array:
    """Weights of points on one axis, zero beyond their reach.

    The values are those of `sample_gaussian` and `cut_negligible`; this is the form for
    many points, with a derivative of its own.

    Args:
      centers: [N], continuous indices. sigma: [N], standard deviations in voxels, >= 0.
      size: cells of the axis, static.

    Returns:
      [N, size].
    """
    return _sample_axis_forward(centers, sigma, size)[0]


def _sample_axis_forward(centers, sigma, size):
    cells = jnp.arange(size, dtype=centers.dtype)
    center, width = centers[:, None], sigma[:, None]
    weights = sample_gaussian(cells, width, center=center)
    weights = cut_negligible(weights, cells, width, center=center)
    return weights, (centers, sigma)


def _sample_axis_backward(size, residuals, cotangent):
    """The sums over cells are matrix products: reductions took most of the time."""
    centers, sigma = residuals
    floored, clip = jax.vjp(lambda s: jnp.maximum(s, SIGMA_FLOOR), sigma)
    nearest = jnp.round(centers)
    offset = centers - nearest
    share, normalise = jax.vjp(lambda x, s: _invert_sum(x, s, 1 / s), offset, floored)
    cells = jnp.arange(size, dtype=centers.dtype)
    inverse = 1 / floored
    distance = cells - nearest[:, None]
    near = distance * inverse[:, None]
    far = (distance - 2 * offset[:, None]) * inverse[:, None]
    weights = cut_negligible(
        jnp.exp(-0.5 * near * far), cells, sigma[:, None], center=centers[:, None]
    )
    # One factor after the other: where the weight is zero the square may overflow.
    first = cotangent * weights
    second = first * near
    ones = jnp.ones(size, centers.dtype)
    total, mean, square = (
        jnp.matmul(part, ones, precision="highest")
        for part in (first, second, second * far)
    )
    by_offset, by_width = normalise(total)
    scaled = share * inverse
    return by_offset + scaled * mean, *clip(by_width + scaled * square)


sample_axis.defvjp(_sample_axis_forward, _sample_axis_backward)


def cut_negligible(weights: chex.Array, cells, sigma, *, center) -> chex.Array:
    """Set weights beyond the kernel's reach to exactly zero, so they can be skipped.

    The reach is where exp(-t²/2) falls below half a rounding unit: what is cut cannot
    change a sum that holds the weight of the nearest cell.
    """
    return jnp.where(
        jnp.abs(cells - center) <= find_reach(sigma, weights.dtype), weights, 0
    )


def find_reach(sigma: chex.Array, dtype) -> chex.Array:
    """Distance in voxels from a Gaussian's mean beyond which it is cut.

    Half a voxel more than `find_half_width`: the weight of the nearest cell, which
    others are compared with, may be that far from the mean.
    """
    return find_half_width(sigma, dtype) + 0.5


def find_half_width(sigma: chex.Array, dtype) -> chex.Array:
    """Distance in voxels at which exp(-t²/2σ²) falls below half a rounding unit."""
    unit = jnp.finfo(dtype).eps / 2
    deviations = jnp.sqrt(-2 * jnp.log(jnp.asarray(unit, dtype)))
    return jnp.maximum(sigma, SIGMA_FLOOR) * deviations
