"""Covariances as conditionals: one-dimensional Gaussians, one axis after the other."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.render import kernels

ORDERS = tuple(itertools.permutations(range(3)))


class Factors(NamedTuple):
    """Gaussians as conditionals: x₁, then x₂ given x₁, then x₃ given x₁ and x₂."""

    sigmas: jax.Array  # [N, 3] standard deviations of these three, in voxels
    # [N, 3] slopes of the conditional means: of x₂ over x₁, of x₃ over x₁, and of x₃
    # over the deviation of x₂ from its mean given x₁.
    slopes: jax.Array


def choose_order(covariance: jax.Array) -> jax.Array:
    """Which of the six orders of axes to factor each covariance [N, 3, 3] in; [N].

    The widest axis first, then the one with the wider conditional, as in pivoting. No
    slope then exceeds one, and no cell that a thin Gaussian is assigned to is more than
    half a voxel from its line or plane.
    """
    variances = jnp.diagonal(covariance, 0, 1, 2)
    first = jnp.argmax(variances, axis=1)  # of equal ones, the lowest axis

    def take(array, index):
        return jnp.take_along_axis(array, index, axis=1)

    widest = take(variances, first[:, None])
    shared = take(covariance, first[:, None, None])[:, 0]
    rest = variances - _divide(shared**2, widest, jnp.zeros_like(widest))
    lower, higher = take(rest, jnp.array([[1, 2], [0, 2], [0, 1]])[first]).T
    return 2 * first + (lower < higher)  # as `ORDERS` lists them


def factor_covariance(covariance: jax.Array) -> Factors:
    """Conditionals of covariances [N, 3, 3], in the order of their axes.

    Negative variances, such as rounding makes of a singular covariance, count as zero;
    a conditional without variance lies on the nearest cell.
    """
    first, zero = covariance[:, 0, 0], jnp.zeros_like(covariance[:, 0, 0])
    ba, ca, cb = covariance[:, 1, 0], covariance[:, 2, 0], covariance[:, 2, 1]
    slope_b = _find_slope(ba, first, zero)
    slope_c = _find_slope(ca, first, zero)
    second = covariance[:, 1, 1] - slope_b * ba
    # A remainder below the rounding error of the subtraction says nothing.
    noise = 8 * jnp.finfo(first.dtype).eps * jnp.abs(first)
    shared = cb - slope_c * ba
    slope_e = _find_slope(shared, second, noise)
    third = covariance[:, 2, 2] - slope_c * ca - slope_e * shared
    return Factors(
        jnp.stack([_take_root(v) for v in (first, second, third)], axis=-1),
        jnp.stack([slope_b, slope_c, slope_e], axis=-1),
    )


def _find_slope(shared, variance, threshold):
    """Slope of a conditional mean; zero where the variance is no more than rounding.

    Over the widest axis no slope exceeds one, but for rounding. One above two comes
    from a matrix that is no covariance, and is set to zero too. The square of the
    variance, by which the derivative divides, must not underflow.
    """
    least = jnp.sqrt(jnp.finfo(variance.dtype).tiny)
    is_safe = jnp.abs(shared) <= 2 * variance
    # Mask both: otherwise a large cotangent times the inverse square of a small
    # variance is infinite before it is multiplied by zero.
    return _divide(
        jnp.where(is_safe, shared, 0),
        jnp.where(is_safe, variance, 0),
        jnp.maximum(threshold, least),
    )


def _divide(numerator, denominator, threshold):
    """Quotient, or zero where the denominator does not exceed the threshold.

    Computed with the inverse. Its derivative multiplies by the numerator before it
    divides by the square of the denominator, which alone might overflow.
    """
    is_safe = denominator > threshold
    return jnp.where(is_safe, numerator * (1 / jnp.where(is_safe, denominator, 1)), 0)


def _take_root(variance):
    """Standard deviation, at least the kernels' floor; no infinite slope at zero."""
    is_wide = variance > kernels.SIGMA_FLOOR**2
    root = jnp.sqrt(jnp.where(is_wide, variance, 1))
    return jnp.where(is_wide, root, kernels.SIGMA_FLOOR)
