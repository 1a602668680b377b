"""Trilinear splatting: against loops, at the border, and where it must lose nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dpc_jax

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


def test_gradients_equal_finite_differences_off_the_cell_planes():
    rng = np.random.default_rng(1)
    base = rng.integers(0, 3, (8, 3))
    coordinates = base + rng.uniform(0.1, 0.9, (8, 3))
    # Between the last centre and the border, where cells outside have no weight.
    border = [[-0.3, 2.4, 1.3], [4.3, 5.2, 3.4], [1.3, -0.2, -0.4]]
    coordinates = np.concatenate([coordinates, border])
    values, weights = rng.normal(size=11), rng.normal(size=SHAPE)
    with jax.enable_x64(True):
        jax.test_util.check_grads(
            lambda c, v: jnp.sum(dpc_jax.splat(c, v, SHAPE) * weights),
            (jnp.asarray(coordinates), jnp.asarray(values)),
            order=1,
            modes=("rev",),
            atol=1e-6,  # central differences of a function linear between planes
            rtol=1e-6,
        )


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


def test_a_point_on_a_cell_centre_fills_that_cell_alone():
    volume = splat([2.0, 3.0, 1.0], [1.0])
    assert volume[2, 3, 1] == 1
    assert volume.sum() == 1


@pytest.mark.parametrize(
    ("point", "cells"), [((2, 3, 1.5), 2), ((2, 3.5, 1.5), 4), ((2.5, 3.5, 1.5), 8)]
)
def test_a_point_on_a_face_edge_or_corner_is_shared_equally(point, cells):
    volume = splat(point, [1.0])
    assert np.sum(volume == 1 / cells) == cells
    assert volume.sum() == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", ["near", "far"])
def test_a_point_one_cell_outside_leaves_no_trace_on_any_side(axis, side):
    point = np.array([2.0, 2.0, 2.0])
    point[axis] = -1.0 if side == "near" else SHAPE[axis]
    assert np.all(splat(point, [1.0]) == 0)

    def total(p):
        return jnp.sum(dpc_jax.splat(p[None], jnp.ones(1), SHAPE) ** 2)

    assert np.all(np.asarray(jax.grad(total)(jnp.asarray(point, jnp.float32))) == 0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_point_on_the_border_keeps_half_and_wraps_nothing_to_the_far_side(axis):
    for border, cell in ((-0.5, 0), (SHAPE[axis] - 0.5, SHAPE[axis] - 1)):
        point = np.array([2.0, 2.0, 2.0])
        point[axis] = border
        index = [2, 2, 2]
        index[axis] = cell
        volume = splat(point, [1.0])
        assert volume[tuple(index)] == 0.5
        assert volume.sum() == 0.5


def test_no_points_and_far_points_make_an_empty_volume():
    assert np.all(splat(np.zeros((0, 3)), np.zeros(0)) == 0)
    assert np.all(splat([[1e30, 0, 0], [0, -1e30, 0]], [1.0, 1.0]) == 0)


def test_a_hundred_thousand_coincident_points_add_up():
    volume = splat(np.tile([1.5, 2.0, 2.0], (100_000, 1)), np.ones(100_000))
    # Sums of halves: exact in float32 up to 2^24.
    assert volume[1, 2, 2] == volume[2, 2, 2] == 50_000


def test_on_a_cell_plane_the_slope_towards_the_higher_index_is_taken():
    weights = np.arange(SHAPE[0], dtype=np.float32) ** 2

    def total(row):
        point = jnp.stack([row, jnp.float32(2), jnp.float32(2)])
        volume = dpc_jax.splat(point[None], jnp.ones(1), SHAPE)
        return jnp.sum(volume * weights[:, None, None])

    assert jax.grad(total)(jnp.float32(2.0)) == 3**2 - 2**2
