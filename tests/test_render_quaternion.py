"""Quaternion operations with scipy as the oracle, and in small dtypes.

Extremes and gradients are cases of tests/test_stability.py.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dpc_jax import quaternion

RANDOM = np.random.default_rng(0).normal(size=(20, 4))
HALF_TURNS = np.array(
    [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 1, 1, 0], [1e-9, 1, -2, 3]]
)
NEAR_IDENTITY = np.array([[1, 1e-7, 0, 0], [1, 0, -1e-7, 1e-7], [1, 0, 0, 0]])
CASES = np.concatenate([RANDOM, HALF_TURNS, NEAR_IDENTITY])


def as_rotation(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def test_all_operations_agree_with_scipy():
    points = np.random.default_rng(1).normal(size=(5, 3))

    @jax.jit
    @jax.vmap
    def compute(left, right):
        product = quaternion.multiply(left, right)
        matrix = quaternion.to_matrix(left)
        return {
            "product": quaternion.to_matrix(product),
            "moved": quaternion.rotate(points, left),
            "inverse": quaternion.to_matrix(quaternion.conjugate(left)),
            "back": quaternion.to_matrix(quaternion.from_matrix(matrix)),
            "angle": quaternion.angle_between(left, right),
        }

    with jax.enable_x64(True):
        found = compute(CASES, CASES[::-1])
    left, right = as_rotation(CASES), as_rotation(CASES[::-1])
    expected = {
        "product": (left * right).as_matrix(),
        "moved": np.stack([turn.apply(points) for turn in left]),
        "inverse": left.inv().as_matrix(),
        "back": left.as_matrix(),
        "angle": (left * right.inv()).magnitude(),
    }
    for name, right in expected.items():  # rounding
        np.testing.assert_allclose(found[name], right, atol=2e-14, err_msg=name)


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
