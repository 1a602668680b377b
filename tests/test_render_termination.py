"""Ray termination: exact at empty and full cells, tiny occupancies, any depth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.volume import clip_unit


@pytest.mark.parametrize("depth", [1, 2, 3, 7, 16, 33])
def test_probabilities_and_opacity_equal_the_loop(depth):
    occupancy = np.random.default_rng(depth).uniform(size=(3, 4, depth))
    occupancy[0, 0] = 0
    occupancy[0, 1] = 1
    with jax.enable_x64(True):
        probabilities, background = dpc_jax.termination_probabilities(
            jnp.asarray(occupancy)
        )
        opacity = dpc_jax.opacity(jnp.asarray(occupancy))
    expected, passed = oracles.terminate(occupancy)
    for value, oracle in (
        (probabilities, expected),
        (background, passed),
        (opacity, 1 - passed),
    ):
        np.testing.assert_allclose(value, oracle, atol=1e-14)  # float64 rounding


@pytest.mark.parametrize(
    ("density", "slope"), [(-0.1, 0.0), (0.0, 1.0), (0.3, 1.0), (1.0, 1.0), (1.1, 0.0)]
)
def test_the_clip_passes_gradients_at_both_of_its_ends(density, slope):
    assert jax.grad(clip_unit)(density) == slope
    assert clip_unit(jnp.float32(density)) == np.clip(np.float32(density), 0, 1)
