"""Ray termination: exact at empty and full cells, tiny occupancies, any depth."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dpc_jax
from dpc_jax.render.volume import clip_unit

CELLS = st.one_of(st.sampled_from([0.0, 1.0, 1e-7]), st.floats(0, 1, width=32))
RAYS = st.lists(CELLS, min_size=6, max_size=6)


def product_of_others(ray):
    """d(1 - Π(1 - o))/do_k by leaving cell k out."""
    return [
        math.prod(1 - o for i, o in enumerate(ray) if i != k) for k in range(len(ray))
    ]


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
    expected, passed = oracles.termination(occupancy)
    for value, oracle in (
        (probabilities, expected),
        (background, passed),
        (opacity, 1 - passed),
    ):
        np.testing.assert_allclose(value, oracle, atol=1e-14)  # float64 rounding


@given(RAYS)
def test_probabilities_are_not_negative_and_sum_to_one(ray):
    probabilities, background = dpc_jax.termination_probabilities(
        jnp.asarray(ray, "f4")
    )
    assert np.min(probabilities) >= 0 and background >= 0
    # A handful of float32 roundings.
    assert float(jnp.sum(probabilities) + background) == pytest.approx(1, abs=2e-6)


@given(RAYS)
def test_opacity_has_the_gradient_of_the_product_also_at_empty_and_full_cells(ray):
    with jax.enable_x64(True):
        gradient = jax.grad(dpc_jax.opacity)(jnp.asarray(ray, "f8"))
    np.testing.assert_allclose(gradient, product_of_others(ray), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("full", list(itertools.combinations(range(4), 2)))
def test_two_full_cells_have_zero_gradient_and_one_has_its_own(full):
    ray = np.full(4, 0.25, "f4")
    ray[full[0]] = 1
    gradient = jax.grad(dpc_jax.opacity)(jnp.asarray(ray))
    np.testing.assert_allclose(gradient, product_of_others(ray), rtol=1e-6)
    ray[full[1]] = 1
    assert np.all(np.asarray(jax.grad(dpc_jax.opacity)(jnp.asarray(ray))) == 0)


@pytest.mark.parametrize("depth", [1, 64, 4096])
def test_occupancies_of_a_billionth_keep_their_digits_in_float32(depth):
    opacity = dpc_jax.opacity(jnp.full(depth, 1e-9, jnp.float32))
    exact = -math.expm1(depth * math.log1p(-float(np.float32(1e-9))))
    assert float(opacity) == pytest.approx(exact, rel=1e-5)  # log2(D) float32 roundings


@pytest.mark.parametrize("depth", [1, 5, 64])
@pytest.mark.parametrize("size", [1e-9, 1e-7, 1e-4])
def test_the_gradient_at_tiny_occupancies_keeps_its_digits_in_float32(size, depth):
    gradient = jax.grad(dpc_jax.opacity)(jnp.full(depth, size, jnp.float32))
    # Factors 1 - 1e-9 round to one: half an ulp, 6e-8, each.
    np.testing.assert_allclose(gradient, (1 - size) ** (depth - 1), rtol=1e-7 * depth)


@pytest.mark.parametrize("full", [(), (0,), (2,), (3,), (0, 2), (1, 3), (0, 1, 2, 3)])
def test_probabilities_have_the_gradient_of_the_product_at_full_cells(full):
    """r_k by its definition, o_k·Π_{u<k}(1 - o_u), differentiated term by term."""
    ray = np.array([0.25, 0.0, 0.5, 0.75])
    ray[list(full)] = 1
    expected = np.zeros((5, 4))
    for k, j in itertools.product(range(5), range(4)):
        own = ray[k] if k < 4 else 1.0
        before = [1 - o for u, o in enumerate(ray) if u < k and u != j]
        if j == k:
            expected[k, j] = math.prod(before)
        elif j < k:
            expected[k, j] = -own * math.prod(before)
    with jax.enable_x64(True):
        jacobians = jax.jacrev(dpc_jax.termination_probabilities)(jnp.asarray(ray))
    found = np.concatenate([jacobians[0], jacobians[1][None]])
    np.testing.assert_allclose(found, expected, atol=1e-15)  # a few roundings


def test_cells_a_rounding_from_full_have_finite_gradients():
    gradient = jax.grad(dpc_jax.opacity)(jnp.full(64, 1 - 1e-7, jnp.float32))
    assert np.all(np.isfinite(gradient)) and np.all(np.asarray(gradient) >= 0)


@pytest.mark.parametrize(
    ("density", "slope"), [(-0.1, 0.0), (0.0, 1.0), (0.3, 1.0), (1.0, 1.0), (1.1, 0.0)]
)
def test_the_clip_passes_gradients_at_both_of_its_ends(density, slope):
    assert jax.grad(clip_unit)(density) == slope
    assert clip_unit(jnp.float32(density)) == np.clip(np.float32(density), 0, 1)
