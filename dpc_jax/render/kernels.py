"""The one-dimensional Gaussian on a grid: the factor of Eq. 3's f_i along one axis.

It is sampled at cell centres and normalised over the unbounded grid, so that the
weights of a point sum to one for every sigma and every position. As sigma → 0, only the
nearest cell keeps a weight.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike, DTypeLike

# Smaller sigmas, in voxels, are raised to this one, so that nothing is divided by zero.
# It is so small that even in float64 exp(-1/(2·sigma²)), what a point on a cell centre
# would give to the next cell, underflows to zero. The floor shows only for a point
# within 0.02 voxels of the middle between two cells: the farther one still has the
# share exp(-e/0.02²) at the distance e from the middle, instead of none.
SIGMA_FLOOR = 0.02
# From this sigma on the normaliser's Poisson sum converges faster than its direct sum.
_WIDE = 0.5


def sample_gaussian(
    cells: jax.Array, sigma: jax.Array, *, center: ArrayLike = 0.0
) -> jax.Array:
    """Weights exp(-(i - x)²/2σ²) / Σ_{k∈Z} exp(-(k - x)²/2σ²).

    Args:
      cells: [...], indices i, whole numbers.
      sigma: broadcastable to `cells`, standard deviation in voxels, >= 0.
      center: broadcastable to `cells`, the Gaussian's mean x as a continuous index.

    Returns:
      [...] weights, of the largest dtype among the arguments. Right to rounding for
      every sigma; no intermediate result overflows.
    """
    center = jnp.asarray(center)
    sigma = jnp.maximum(sigma, SIGMA_FLOOR)
    # Both sums are taken relative to the weight of the nearest cell: all exponents are
    # then <= 0, and 0 at that cell, so that nothing cancels or underflows in a narrow
    # kernel. The quotient of the sums does not depend on which cell they are relative
    # to, so the jump from one cell to the next needs no derivative.
    nearest = jax.lax.stop_gradient(jnp.round(center))
    offset = center - nearest
    distance = cells - nearest
    # The product with 1/σ, not a division by σ, whose derivative contains 1/σ²: in
    # float16 that overflows, and its product with zero would be NaN.
    inverse = 1 / sigma
    weights = jnp.exp(-0.5 * (distance * inverse) * ((distance - 2 * offset) * inverse))
    return weights * _invert_sum(offset, sigma, inverse)


def _invert_sum(offset, sigma, inverse):
    """1 / Σ_{k∈Z} exp(-k(k - 2δ)/2σ²), the inverse of a theta function; |δ| <= 1/2.

    A narrow kernel is summed directly. A wide one is summed after Poisson's formula:
    the sum equals √(2π)·σ·exp(δ²/2σ²)·(1 + 2·Σ_{m>=1} exp(-2π²m²σ²)·cos(2πmδ)).
    """
    # Not minimum and maximum, which pass half of the derivative on the border.
    is_narrow = sigma < _WIDE
    narrow = jnp.where(is_narrow, inverse, 1 / _WIDE)
    wide = jnp.where(is_narrow, 1 / _WIDE, inverse)
    direct = 1 + sum(
        jnp.exp(-0.5 * (k * narrow) * ((k - 2 * offset) * narrow))
        for k in range(-4, 5)
        if k != 0
    )
    # Beyond σ = 4 the waves are below 1e-137, and their exponent may overflow.
    low = jnp.where(is_narrow, _WIDE, jnp.where(sigma < 4, sigma, 4))
    wave = jnp.cos(2 * jnp.pi * offset)  # cos 2x and cos 3x follow from cos x
    harmonics = (wave, 2 * wave**2 - 1, (4 * wave**2 - 3) * wave)
    terms = (
        jnp.exp(-2 * (jnp.pi * m * low) ** 2) * harmonic
        for m, harmonic in enumerate(harmonics, 1)
    )
    waves = jnp.add(1, 2 * sum(terms))
    root = jnp.sqrt(jnp.asarray(2 * jnp.pi, waves.dtype))
    poisson = root * jnp.exp(0.5 * (offset * wide) ** 2) * waves
    # The sum is σ times `poisson`. That product may overflow; its inverse does not.
    return jnp.where(is_narrow, 1, inverse) / jnp.where(is_narrow, direct, poisson)


def sample_axis(centers: jax.Array, sigma: jax.Array, size: int) -> jax.Array:
    """Weights [N, size] of points [N] on an axis, zero beyond their reach.

    A weight that is cut is below half a rounding unit of the nearest cell's: added to
    that one it would change nothing.
    """
    cells = jnp.arange(size, dtype=centers.dtype)[None]
    center, width = centers[:, None], sigma[:, None]
    weights = sample_gaussian(cells, width, center=center)
    is_near = jnp.abs(cells - center) <= find_reach(width, weights.dtype)
    return jnp.where(is_near, weights, 0)


def find_reach(sigma: jax.Array, dtype: DTypeLike) -> jax.Array:
    """Distance in voxels from a Gaussian's mean beyond which it is cut.

    Half a voxel more than `find_half_width`, because the nearest cell, with which the
    others are compared, may be that far from the mean.
    """
    return find_half_width(sigma, dtype) + 0.5


def find_half_width(sigma: jax.Array, dtype: DTypeLike) -> jax.Array:
    """Distance in voxels at which exp(-t²/2σ²) falls below half a rounding unit."""
    unit = jnp.finfo(dtype).eps / 2
    deviations = jnp.sqrt(-2 * jnp.log(jnp.asarray(unit, dtype)))
    return jnp.maximum(sigma, SIGMA_FLOOR) * deviations
