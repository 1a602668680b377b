"""Gaussian smoothing: against direct sums, for sigma from nothing to 1000 voxels."""

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest

import dpc_jax
from dpc_jax.render.kernels import sample_gaussian

SHAPE = (5, 7, 6)
VOLUME = np.random.default_rng(0).uniform(size=SHAPE)
smooth = jax.jit(dpc_jax.smooth)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.3, 0.99, 1.0, 1.01, 5.0, 1e3])
def test_smoothing_equals_the_direct_sum_in_float64(sigma):
    with jax.enable_x64(True):
        result = smooth(jnp.asarray(VOLUME), sigma)
    # Rounding of three sums of at most seven terms.
    np.testing.assert_allclose(result, oracles.smooth(VOLUME, sigma), atol=1e-13)


@pytest.mark.parametrize("sigma", [0.0, 1e-30, 1e-3])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_vanishing_sigma_is_the_identity_with_zero_slope(sigma, dtype):
    with jax.enable_x64(dtype == "float64"):
        volume = jnp.asarray(VOLUME, dtype)
        np.testing.assert_array_equal(smooth(volume, sigma), volume)
        total = jax.grad(lambda s: jnp.sum(smooth(volume, s) ** 2))
        assert float(total(jnp.asarray(sigma, dtype))) == 0


@pytest.mark.parametrize("sigma", [0.25, 0.6, 0.999, 1.0, 1.001, 3.0, 1e3])
def test_the_slope_in_sigma_equals_finite_differences(sigma):
    def total(s):
        return jnp.sum(smooth(jnp.asarray(VOLUME), s) * VOLUME)

    step = 1e-6 * max(sigma, 1)
    with jax.enable_x64(True):
        slope = jax.grad(total)(jnp.asarray(sigma))
        expected = (total(sigma + step) - total(sigma - step)) / (2 * step)
        # Central differences in float64: 1e-16/1e-6 of rounding.
        assert float(slope) == pytest.approx(float(expected), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("sigma", [1e-3, 0.2, 0.5, 0.999, 1.0, 1.5, 10.0, 300.0])
def test_the_kernel_sums_to_one_over_the_integers(sigma):
    distances = jnp.arange(-5000, 5001, dtype=jnp.float32)
    # float32 rounding of ten thousand terms, pairwise summed.
    total = np.sum(np.asarray(sample_gaussian(distances, jnp.float32(sigma)), float))
    assert total == pytest.approx(1, abs=3e-6)


def test_smoothing_is_its_own_transpose():
    rng = np.random.default_rng(1)
    other = rng.uniform(size=SHAPE)
    with jax.enable_x64(True):
        left = np.sum(other * smooth(jnp.asarray(VOLUME), 1.3))
        right = np.sum(VOLUME * smooth(jnp.asarray(other), 1.3))
    assert float(left) == pytest.approx(float(right), rel=1e-13)
