"""Gaussian smoothing: against direct sums, for sigma from nothing to 1000 voxels."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.kernels import sample_gaussian

smooth = jax.jit(dpc_jax.smooth)


def smooth_directly(volume, sigma):
    """Direct sums in float64: long doubles would take minutes."""
    for axis, size in enumerate(volume.shape):
        cells = np.arange(size)
        matrix = oracles.weigh(cells, cells[:, None], sigma).astype(float)
        volume = np.moveaxis(np.tensordot(matrix, volume, axes=(1, axis)), 0, axis)
    return volume


@pytest.mark.parametrize("sigma", [1e-3, 0.2, 0.5, 0.999, 1.0, 1.5, 10.0, 300.0])
def test_the_kernel_sums_to_one_over_the_integers(sigma):
    distances = jnp.arange(-5000, 5001, dtype=jnp.float32)
    # float32 rounding of ten thousand terms, pairwise summed.
    total = np.sum(np.asarray(sample_gaussian(distances, jnp.float32(sigma)), float))
    assert total == pytest.approx(1, abs=3e-6)


# Half-widths of the kernels that each size has a branch for; the first is none.
WIDTHS = {16: (0,), 33: (0, 1, 4, 9), 64: (0, 1, 4, 18)}
ROUNDING = {"float32": 2.0**-24, "float64": 2.0**-53}


def find_threshold(width, dtype):
    """Sigma at which the cell after the last of a half-width falls below rounding."""
    return (width + 1) / math.sqrt(-2 * math.log(ROUNDING[dtype]))


@pytest.mark.parametrize("size", [16, 33])
def test_every_branch_equals_the_direct_sum_with_its_gradients(size):
    """On both sides of each threshold."""
    shape = (size + 1, size, size + 2)
    rng = np.random.default_rng(size)
    volume, weights = rng.uniform(size=shape), rng.normal(size=shape)

    @jax.jit
    def differentiate(volume, sigma):
        def measure(volume, sigma):
            smoothed = dpc_jax.smooth(volume, sigma)
            return jnp.sum(smoothed * weights), smoothed

        call = jax.value_and_grad(measure, argnums=(0, 1), has_aux=True)
        (_, smoothed), slopes = call(volume, sigma)
        return smoothed, *slopes

    thresholds = [find_threshold(width, "float64") for width in WIDTHS[size]]
    for sigma in (side * t for t in thresholds for side in (0.99, 1.01)):
        with jax.enable_x64(True):
            smoothed, slope, sigma_slope = differentiate(jnp.asarray(volume), sigma)
        expected = smooth_directly(volume, sigma)
        # Rounding of three sums of at most 66 terms, of which each is below one.
        np.testing.assert_allclose(smoothed, expected, atol=2e-15)
        np.testing.assert_allclose(slope, smooth_directly(weights, sigma), atol=1e-14)
        step = 1e-5 * sigma
        sides = [
            np.sum(smooth_directly(volume, sigma + s * step) * weights) for s in (1, -1)
        ]
        # Differences of a sum of order 100 with rounding 1e-14.
        numeric = (sides[0] - sides[1]) / (2 * step)
        assert float(sigma_slope) == pytest.approx(numeric, rel=1e-6, abs=1e-13 / step)


@pytest.mark.parametrize("size", [33, 64])
def test_sigma_decides_how_far_the_columns_are_summed(size):
    impulse = jnp.zeros((size,) * 3, "f4").at[size // 2, 0, size // 2].set(1.0)

    def find_reach(sigma):
        smoothed = smooth(impulse, jnp.float32(sigma))
        return int(np.flatnonzero(smoothed[size // 2, :, size // 2]).max())

    before = 0
    for width in WIDTHS[size]:
        threshold = find_threshold(width, "float32")
        assert find_reach(0.99 * threshold) == width
        # The next branch, which reaches as far as numbers go.
        assert find_reach(1.01 * threshold) > width >= before
        before = width
