"""Separable Gaussian smoothing of a volume, the second step of the fast method.

Smoothing along an axis of D cells is a product with the D×D Toeplitz matrix of the
kernel: nothing is truncated, and sigma may be traced. A narrow kernel, whose tails are
below rounding, is applied as a short sum of shifted volumes instead, with the same
result to rounding. Which of the two is run depends on sigma, at run time.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from dpc_jax.render import checks, kernels

# Half-widths up to which sums of shifts are faster than matrix products (measured on
# two CPU cores with `dpc_jax.benchmark`): those of _NARROW along all three axes, up to
# _MEDIUM (by the volume's largest side) along the columns alone, where the alternative
# is a batch of small matrix products.
_NARROW = (1, 4)
_MEDIUM = {32: 9, 64: 18, 128: 18}
# Below this side all kernels are applied as matrix products.
_SMALLEST = 17


def smooth(volume: jax.Array, sigma: jax.Array) -> jax.Array:
    """Convolve a volume with an isotropic Gaussian; cells outside count as empty.

    Part of Eq. 3 by the fast method (appendix "Differentiable point cloud projection").

    Args:
      volume: [rows, cols, depth], as the result.
      sigma: (), standard deviation in voxels, >= 0. Below 0.17 voxels in float32 (0.12
        in float64) a neighbour's share is less than rounding: the volume is returned as
        it is, and nothing is computed.

    Returns:
      [rows, cols, depth].

    Raises:
      ValueError: for another shape or dtype, and a sigma that is known to be below 0.

    Example:
      >>> volume = jnp.zeros((9, 9, 9)).at[4, 4, 4].set(1.0)
      >>> round(float(dpc_jax.smooth(volume, jnp.array(1.0))[4, 4, 4]), 3)
      0.063
    """
    volume = checks.check_array("volume", volume, (None, None, None))
    checks.check_sides("the volume's shape", volume.shape)
    number = checks.check_real("sigma", sigma, ())
    checks.check_values({"sigma": sigma})
    return _smooth(volume, number.astype(volume.dtype))


@jax.custom_vjp
def _smooth(volume, sigma):
    kernel = _sample_kernel(sigma, volume)
    size = max(volume.shape)
    widths: list[int] = [0]
    branches: list[Callable] = []
    if min(volume.shape) >= _SMALLEST:
        medium = [(width, (1,)) for side, width in _MEDIUM.items() if side <= size]
        narrow = [(width, (0, 1, 2)) for width in _NARROW]
        for width, axes in [*narrow, *medium[-1:]]:
            call = functools.partial(_smooth_axes, half_width=width, shifted=axes)
            widths.append(width)
            branches.append(call)
    branches.append(_smooth_axes)
    # Half-width w is exact to rounding as long as cell w + 1 is out of reach.
    reach = kernels.find_half_width(jnp.asarray(sigma, volume.dtype), volume.dtype)
    level = jnp.sum(reach >= jnp.array([w + 1.0 for w in widths], volume.dtype))

    def choose(volume, kernel):
        # Of a sigma known to the compiler one branch would be left, and its sums of
        # shifts be computed again for each shift of the next axis, which takes four
        # times as long.
        hidden = jax.lax.optimization_barrier(level)
        return jax.lax.switch(hidden - 1, branches, volume, kernel)

    return jax.lax.cond(level > 0, choose, lambda volume, _: volume, volume, kernel)


def _smooth_forward(volume, sigma):
    # The backward pass needs the volume only for the gradient of sigma.
    kept = volume.value if sigma.perturbed else None
    return _smooth(volume.value, sigma.value), (kept, sigma.value)


def _smooth_backward(residuals, cotangent):
    """Smooth the cotangent: smoothing is its own transpose."""
    volume, sigma = residuals
    if isinstance(cotangent, jax.custom_derivatives.SymbolicZero):
        cotangent = jnp.zeros(cotangent.shape, sigma.dtype)
    sigma_grad = None
    if volume is not None:
        _, pull_back = jax.vjp(
            lambda s: _smooth_axes(volume, _sample_kernel(s, volume)), sigma
        )
        (sigma_grad,) = pull_back(cotangent)
    return _smooth(cotangent, sigma), sigma_grad


_smooth.defvjp(_smooth_forward, _smooth_backward, symbolic_zeros=True)


def _sample_kernel(sigma, volume):
    distances = jnp.arange(max(volume.shape), dtype=volume.dtype)
    return kernels.sample_gaussian(distances, jnp.asarray(sigma, volume.dtype))


def _smooth_axes(volume, kernel, *, half_width=0, shifted=()):
    """Smooth axis by axis: by sums of shifts where `shifted`, else as products."""
    multiply = functools.partial(jnp.matmul, precision="highest")
    rows, cols, depth = (_make_toeplitz(kernel, size) for size in volume.shape)
    for axis in (2, 1, 0):
        if axis in shifted:
            volume = _add_shifts(volume, kernel, axis=axis, half_width=half_width)
        elif axis == 2:
            volume = multiply(volume, depth)
        elif axis == 1:
            volume = multiply(cols, volume)
        else:
            flat = volume.reshape(volume.shape[0], -1)
            volume = multiply(rows, flat).reshape(volume.shape)
    return volume


def _make_toeplitz(kernel, size):
    cells = jnp.arange(size)
    return kernel[jnp.abs(cells[:, None] - cells[None, :])]


def _add_shifts(volume, kernel, *, axis, half_width):
    """Σ_j g_j·(v[i - j] + v[i + j])."""
    size = volume.shape[axis]
    padding = [(0, 0)] * 3
    padding[axis] = (half_width, half_width)
    padded = jnp.pad(volume, padding)

    def shift(by):
        start = half_width + by
        return jax.lax.slice_in_dim(padded, start, start + size, axis=axis)

    pairs = (
        kernel[j] * (shift(-j) + shift(j))
        for j in range(1, min(half_width + 1, kernel.shape[0]))
    )
    return functools.reduce(jnp.add, pairs, kernel[0] * volume)
