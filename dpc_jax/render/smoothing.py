"""Separable Gaussian smoothing of a volume, the second step of the fast method.

The kernel is sampled at whole voxels and normalised over the unbounded grid, so mass is
exact for every sigma. Smoothing along an axis of D cells is a product with the D×D
Toeplitz matrix of the kernel: nothing is truncated and sigma may be traced.
"""

import chex
import jax
import jax.numpy as jnp

# Below this many voxels the neighbour's share exp(-1/(2·sigma²)) underflows to zero in
# float64 too, so the kernel is the identity and its derivative zero; the floor keeps
# sigma = 0 and 1e-30 from dividing by zero and changes no representable value.
_SIGMA_FLOOR = 0.02


def sample_gaussian(distances: chex.Array, sigma: chex.Array) -> chex.Array:
    """Gaussian at whole-voxel distances, normalised over all integers.

    Args:
      distances: [...], integers in voxels.
      sigma: (), standard deviation in voxels, >= 0.

    Returns:
      [...] samples of exp(-d²/2σ²) / Σ_{k∈Z} exp(-k²/2σ²).
    """
    sigma = jnp.maximum(sigma, _SIGMA_FLOOR)
    # The normaliser is a theta function: the sum itself converges fast for small
    # sigma, its Poisson transform for large; at 1 both are right to 1e-16.
    # Not minimum and maximum: at sigma = 1 each would pass half of the derivative.
    is_narrow = sigma < 1
    narrow = jnp.where(is_narrow, sigma, 1)
    wide = jnp.where(is_narrow, 1, sigma)
    k = jnp.arange(1, 10, dtype=distances.dtype)
    sum_narrow = 1 + 2 * jnp.sum(jnp.exp(-0.5 * (k / narrow) ** 2))
    k = jnp.arange(1, 3, dtype=distances.dtype)
    sum_wide = (
        jnp.sqrt(2 * jnp.pi).astype(distances.dtype)
        * wide
        * (1 + 2 * jnp.sum(jnp.exp(-2 * (jnp.pi * k * wide) ** 2)))
    )
    total = jnp.where(is_narrow, sum_narrow, sum_wide)
    return jnp.exp(-0.5 * (distances / sigma) ** 2) / total


def smooth(volume: chex.Array, sigma: chex.Array) -> chex.Array:
    """Convolve a volume with an isotropic Gaussian; cells outside count as empty.

    Args:
      volume: [rows, cols, depth].
      sigma: (), standard deviation in voxels, >= 0; 0 leaves the volume as it is.

    Returns:
      [rows, cols, depth].
    """
    chex.assert_rank(volume, 3)
    sigma = jnp.asarray(sigma, volume.dtype)
    sizes = volume.shape
    kernel = sample_gaussian(jnp.arange(max(sizes), dtype=volume.dtype), sigma)
    rows, cols, depth = (
        kernel[jnp.abs(jnp.arange(s)[:, None] - jnp.arange(s)[None, :])] for s in sizes
    )
    exact = jax.lax.Precision.HIGHEST
    volume = jnp.matmul(volume, depth, precision=exact)
    volume = jnp.matmul(cols, volume, precision=exact)
    flat = volume.reshape(sizes[0], -1)
    return jnp.matmul(rows, flat, precision=exact).reshape(sizes)
