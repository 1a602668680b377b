"""Trilinear splatting: against loops, at the border, and where it must lose nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dpc_jax
from dpc_jax.measure.stability import oracles

SHAPE = (5, 6, 4)


_splat = jax.jit(dpc_jax.splat, static_argnums=2)


def splat(coordinates, values, shape=SHAPE):
    coordinates = jnp.asarray(coordinates, jnp.float32).reshape(-1, 3)
    return np.asarray(_splat(coordinates, jnp.asarray(values, jnp.float32), shape))


@pytest.mark.parametrize("shape", [(5, 6, 4), (1, 1, 9), (1, 7, 1), (1, 1, 1)])
def test_splatting_equals_the_loops_in_float64(shape):
    rng = np.random.default_rng(0)
    coordinates = rng.uniform(-1.5, np.array(shape) + 0.5, (60, 3))
    values = rng.normal(size=60)
    with jax.enable_x64(True):
        volume = dpc_jax.splat(jnp.asarray(coordinates), jnp.asarray(values), shape)
    expected = oracles.splat(coordinates, values, shape)
    np.testing.assert_allclose(volume, expected, atol=1e-13)  # float64 rounding


@given(
    st.lists(
        st.tuples(*[st.floats(0, s - 1, width=32) for s in SHAPE]),
        min_size=8,
        max_size=8,
    )
)
def test_mass_is_conserved_inside(points):
    volume = splat(points, np.ones(len(points)))
    # One float32 rounding per corner and addition.
    assert volume.sum() == pytest.approx(len(points), abs=1e-5)
    assert volume.min() >= 0
