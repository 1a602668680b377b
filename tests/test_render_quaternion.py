"""Quaternion operations: algebra, scipy as the oracle, and where they may break."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dpc_jax import quaternion

RANDOM = np.random.default_rng(0).normal(size=(20, 4))
HALF_TURNS = np.array(
    [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 1, 1, 0], [1e-9, 1, -2, 3]]
)
NEAR_IDENTITY = np.array([[1, 1e-7, 0, 0], [1, 0, -1e-7, 1e-7], [1, 0, 0, 0]])
CASES = np.concatenate([RANDOM, HALF_TURNS, NEAR_IDENTITY])


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def as_rotation(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def test_products_matrices_and_rotated_points_agree_with_scipy():
    points = np.random.default_rng(1).normal(size=(5, 3))
    for left, right in zip(CASES, CASES[::-1], strict=True):
        product = quaternion.multiply(jnp.asarray(left), jnp.asarray(right))
        expected = (as_rotation(left) * as_rotation(right)).as_matrix()
        np.testing.assert_allclose(quaternion.to_matrix(product), expected, atol=1e-14)
        moved = quaternion.rotate(jnp.asarray(points), jnp.asarray(left))
        np.testing.assert_allclose(moved, as_rotation(left).apply(points), atol=1e-14)


def test_every_rotation_comes_back_from_its_matrix_half_turns_too():
    for q in CASES:
        back = quaternion.from_matrix(quaternion.to_matrix(jnp.asarray(q)))
        # 1e-14: rounding; the sign of a quaternion is free.
        assert abs(np.dot(back, q / np.linalg.norm(q))) == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(
            quaternion.to_matrix(back), as_rotation(q).as_matrix(), atol=1e-14
        )


def test_a_matrix_passes_a_finite_gradient_in_every_branch():
    differentiate = jax.jit(jax.jacrev(quaternion.from_matrix))
    for q in CASES:
        matrix = jnp.asarray(as_rotation(q).as_matrix())
        jacobian = differentiate(matrix)
        assert np.all(np.isfinite(jacobian))


COMPONENTS = st.tuples(*[st.floats(-2, 2)] * 4)
QUATERNIONS = COMPONENTS.filter(lambda q: np.linalg.norm(q) > 1e-3)


@given(QUATERNIONS, QUATERNIONS, QUATERNIONS)
def test_the_algebra_of_quaternions_holds(a, b, c):
    a, b, c = (np.asarray(q) for q in (a, b, c))
    with jax.enable_x64(True):  # hypothesis runs each example outside the fixture
        multiply = quaternion.multiply
        left, right = multiply(multiply(a, b), c), multiply(a, multiply(b, c))
        reverse = multiply(quaternion.conjugate(b), quaternion.conjugate(a))
        size = np.linalg.norm(multiply(a, b))
        angles = [
            float(quaternion.angle_between(*p)) for p in ((a, b), (b, a), (-a, b))
        ]
        turned = quaternion.angle_between(multiply(c, a), multiply(c, b))
    # Norms are at most 4, so a product of three has roundings of 64 · 1e-16.
    np.testing.assert_allclose(left, right, atol=1e-13)
    np.testing.assert_allclose(
        reverse, quaternion.conjugate(multiply(a, b)), atol=1e-13, rtol=0
    )
    assert size == pytest.approx(np.linalg.norm(a) * np.linalg.norm(b), abs=1e-13)
    assert angles == pytest.approx([angles[0]] * 3, abs=1e-12)
    assert float(turned) == pytest.approx(angles[0], abs=1e-12)


def test_a_quaternion_times_its_conjugate_is_the_identity():
    for q in CASES:
        unit = quaternion.normalize(jnp.asarray(q))
        product = quaternion.multiply(unit, quaternion.conjugate(unit))
        np.testing.assert_allclose(product, quaternion.IDENTITY, atol=1e-15)


@pytest.mark.parametrize("dtype", ["float16", "bfloat16", "float32"])
def test_turns_as_small_as_a_dtype_holds_have_finite_angles_and_slopes(dtype):
    # float16 holds numbers whose inverse it does not: the difference of two nearly
    # equal unit quaternions is often one.
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(2000, 4))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    near = unit + rng.normal(size=unit.shape) * 10 ** rng.uniform(-8, -1, (2000, 1))
    angles, slopes = jax.jit(
        jax.vmap(jax.value_and_grad(quaternion.angle_between, (0, 1)))
    )(jnp.asarray(unit, dtype), jnp.asarray(near, dtype))
    assert all(bool(jnp.all(jnp.isfinite(a))) for a in (angles, *slopes))
    tiny = jnp.finfo(dtype).smallest_subnormal if dtype == "float16" else 1e-30
    found = quaternion.normalize(jnp.asarray([0, tiny, 0, tiny], dtype))
    expected = np.sqrt([0, 0.5, 0, 0.5])
    unit = float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(np.asarray(found, "f8"), expected, atol=2 * unit)
