"""Learned cameras: the mean that images leave free."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import tiny_config

from dpc_jax.config import Pose, replace_fields
from dpc_jax.learning import devices
from dpc_jax.learning.cameras import Cameras, compute_gauge
from dpc_jax.render import Camera

pytestmark = pytest.mark.usefixtures("quickly")
BOTH = Pose(translation=True, focal_length=True)


def draw_cameras():
    rng = np.random.default_rng(0)
    moved = jnp.asarray(rng.normal(0.02, 0.1, (4, 2, 3)), jnp.float32)
    focal = jnp.asarray(1.875 * rng.uniform(0.9, 1.3, (4, 2)), jnp.float32)
    return Cameras(moved, focal)


def measure(cameras, count, pose=BOTH):
    """The gauge and its gradient; a training step averages over devices like this."""
    config = replace_fields(tiny_config(), {"run": {"devices": count}})
    mesh = devices.make_mesh(config)

    def compare(cameras):
        return compute_gauge(cameras, Camera(), pose=pose)[None] / mesh.size

    shared = devices.share(compare, mesh, (devices.OBJECTS,), devices.OBJECTS)
    return jax.value_and_grad(lambda cameras: jnp.sum(shared(cameras)))(cameras)


def test_the_gauge_is_the_squared_mean_of_all_views():
    cameras = draw_cameras()
    moved = np.asarray(cameras.translations, np.float64).reshape(-1, 3)
    shares = np.log(np.asarray(cameras.focal_lengths, np.float64) / 1.875)
    value, gradient = measure(cameras, 1)
    expected = np.sum(moved.mean(axis=0) ** 2) + shares.mean() ** 2
    assert float(value) == pytest.approx(expected, rel=1e-5)  # float32
    # Every view is pushed alike, whatever its own place.
    np.testing.assert_allclose(
        gradient.translations,
        np.broadcast_to(2 * moved.mean(axis=0) / 8, (4, 2, 3)),
        rtol=1e-4,
    )


def test_several_devices_have_one_gauge():
    value, gradient = measure(draw_cameras(), 1)
    shared_value, shared_gradient = measure(draw_cameras(), 4)
    assert float(shared_value) == pytest.approx(float(value), rel=1e-5)
    for one, four in zip(gradient, shared_gradient, strict=True):
        np.testing.assert_allclose(four, one, rtol=1e-5)


@pytest.mark.parametrize("name", ["translation", "focal_length"])
def test_what_is_read_from_the_data_is_left_alone(name):
    alone = Pose(translation=name == "translation", focal_length=name != "translation")
    _, gradient = measure(draw_cameras(), 1, alone)
    own, other = gradient if name == "translation" else gradient[::-1]
    assert np.any(own) and not np.any(other)


def test_cameras_of_the_config_in_the_mean_cost_nothing():
    moved = jnp.array([[[0.1, 0.0, -0.2]], [[-0.1, 0.0, 0.2]]])
    focal = 1.875 * jnp.array([[1.25], [0.8]])
    assert float(measure(Cameras(moved, focal), 1)[0]) == pytest.approx(0, abs=1e-12)
