"""Learned cameras: the mean that images leave free."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_recipe, tiny_config

from dpc_jax.config import Pose
from dpc_jax.learning import devices
from dpc_jax.learning.cameras import anchor_cameras

RNG = np.random.default_rng(0)
CAMERAS = {
    "translation": jnp.asarray(RNG.normal(0.02, 0.1, (8, 3)), jnp.float32),
    "focal_length": jnp.asarray(1.875 * RNG.uniform(0.9, 1.3, 8), jnp.float32),
}


def measure(cameras, count, **learned):
    """The loss and its gradient; a training step averages over devices like this."""
    config = tiny_config(devices=count)
    mesh = devices.make_mesh(config)

    def compare(cameras):
        recipe = make_recipe(config)._replace(pose=Pose(**learned))
        return (
            anchor_cameras(cameras, recipe=recipe)["camera_mean"].value[None]
            / mesh.size
        )

    parts = {"in_specs": (devices.OBJECTS,), "out_specs": devices.OBJECTS}
    shared = jax.shard_map(compare, mesh=mesh, **parts, check_vma=False)
    return jax.value_and_grad(lambda cameras: jnp.sum(shared(cameras)))(cameras)


@pytest.mark.parametrize("count", [1, 4])
def test_the_loss_of_cameras_is_the_squared_mean_of_all_views_of_all_devices(count):
    moved = np.asarray(CAMERAS["translation"], np.float64)
    shares = np.log(np.asarray(CAMERAS["focal_length"], np.float64) / 1.875)
    value, gradient = measure(CAMERAS, count, translation=True, focal_length=True)
    expected = np.sum(moved.mean(axis=0) ** 2) + shares.mean() ** 2
    assert float(value) == pytest.approx(expected, rel=1e-5)  # float32
    # Every view is pushed alike, whatever its own place.
    alike = np.broadcast_to(2 * moved.mean(axis=0) / 8, (8, 3))
    np.testing.assert_allclose(gradient["translation"], alike, rtol=1e-4)


@pytest.mark.parametrize("name", ["translation", "focal_length"])
def test_what_is_read_from_the_data_is_left_alone(name):
    _, gradient = measure(CAMERAS, 1, **{name: True})
    assert np.any(gradient.pop(name))
    assert not np.any(*gradient.values())
