"""Quaternions in small dtypes; operations are cases of tests/test_stability.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax import quaternion


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
