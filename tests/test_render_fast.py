"""The steps of the fast method against direct sums: splines, then smoothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.fast import splatting

RNG = np.random.default_rng(0)


def draw_inside(shape, count=20):
    """Everywhere in the volume, on its faces, on centres of cells and between them."""
    places = RNG.uniform(-0.5, np.array(shape) - 0.5, (count, 3))
    places[:3] = [[-0.5] * 3, np.array(shape) - 0.5, np.array(shape) // 2]
    places[3:6] = np.round(places[3:6] * 2) / 2
    return places


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("shape", [(1, 2, 9), (3, 7, 1)])
def test_splines_reach_over_the_faces_of_a_thin_volume(order, shape):
    places, values = draw_inside(shape), RNG.uniform(size=20)
    with jax.enable_x64(True):
        inputs = jnp.asarray(places), jnp.asarray(values), shape
        found = splatting.splat_inside(*inputs, order)
    # float64, sums of some 60 products.
    expected = oracles.splat(places, values, shape, order)
    np.testing.assert_allclose(found, expected.astype(float), atol=1e-14)


def smooth_directly(volume, sigma):
    """Direct sums in float64: long doubles would take minutes."""
    for axis, size in enumerate(volume.shape):
        cells = np.arange(size)
        matrix = oracles.weigh(cells, cells[:, None], sigma).astype(float)
        volume = np.moveaxis(np.tensordot(matrix, volume, axes=(1, axis)), 0, axis)
    return volume


@pytest.mark.parametrize("size, widths", [(16, (0,)), (33, (0, 1, 4, 9))])
def test_every_branch_of_smoothing_is_the_direct_sum_with_its_gradients(size, widths):
    """On both sides of where the cell after a half-width falls below rounding."""
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

    thresholds = [(width + 1) / np.sqrt(-2 * np.log(2.0**-53)) for width in widths]
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
