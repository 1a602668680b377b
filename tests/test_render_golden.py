"""The released code's own projection, reproduced from its inputs and outputs.

Its frame is (depth, up, right), which a rotation of (0, 1, 0, 1)/√2 maps to ours, and
its grid is corner-aligned: ours with extent D/(D - 1).
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax import quaternion

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("name", ["a32", "b32", "c64"])
def test_the_released_codes_silhouettes_and_gradients_are_reproduced(name):
    golden = np.load(GOLDEN / f"{name}.npz")
    side = int(golden["grid"])
    grid = dpc_jax.VoxelGrid(side, extent=side / (side - 1))
    to_ours = jnp.array([0.0, 1.0, 0.0, 1.0]) / jnp.sqrt(2.0)

    def render(points, pose, scale):
        return dpc_jax.project(
            points,
            quaternion.multiply(to_ours, quaternion.normalize(pose)),
            sigma=golden["sigma"],
            scale=scale[0],
            grid=grid,
        ).silhouette

    def loss(*inputs):
        silhouettes = jax.vmap(render)(*inputs)
        return jnp.sum((silhouettes - golden["target"]) ** 2), silhouettes

    inputs = [jnp.asarray(golden[n]) for n in ("points", "quaternion", "scale")]
    compute = jax.jit(jax.value_and_grad(loss, argnums=(0, 1, 2), has_aux=True))
    (_, silhouettes), gradients = compute(*inputs)
    # The released kernel is cut at 11 or 21 taps: 2e-4 where that is 3.3 sigma.
    np.testing.assert_allclose(silhouettes, golden["silhouette"], atol=5e-4)
    for gradient, key in zip(gradients, ("points", "quaternion", "scale"), strict=True):
        expected = golden[f"grad_{key}"]
        error = np.linalg.norm(gradient - expected) / np.linalg.norm(expected)
        assert error < 1e-2, f"{key}: {error:.1e}"
