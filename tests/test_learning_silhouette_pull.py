"""The pull on points outside of silhouettes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from tiny_runs import make_batch, make_network, make_state, make_step, tiny_config

from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.silhouette_pull import measure_outside, pull_batch, pull_inside
from dpc_jax.render import Camera, quaternion

pytestmark = pytest.mark.usefixtures("quickly")
AHEAD = jnp.array([1.0, 0, 0, 0])


def draw_disc(side=24, radius=0.2):
    steps = (jnp.arange(side) + 0.5) / side - 0.5
    return (steps[:, None] ** 2 + steps[None] ** 2 < radius**2).astype(jnp.float32)


def test_the_distance_is_the_euclidean_one_to_the_nearest_covered_pixel():
    rng = np.random.default_rng(0)
    mask = ndimage.gaussian_filter(rng.normal(size=(20, 20)), 2) > 0.1
    assert 0 < mask.sum() < mask.size
    expected = ndimage.distance_transform_edt(~mask) / 20
    found = measure_outside(jnp.asarray(mask, jnp.float32))
    np.testing.assert_allclose(found, expected, atol=1e-6)  # float32


def test_half_covered_pixels_count_as_the_object():
    mask = jnp.zeros((4, 4)).at[1, 1].set(0.5).at[3, 3].set(0.49)
    assert float(measure_outside(mask)[3, 3]) == pytest.approx(np.sqrt(8) / 4)


def test_points_outside_are_told_the_way_in_and_those_inside_nothing():
    outside = measure_outside(draw_disc())
    points = jnp.array([[0.0, 0, 0], [0.05, -0.05, 0.2], [0.4, 0, 0], [0, -0.3, 0.1]])

    def pull(points):
        return pull_inside(points, AHEAD, outside, camera=Camera())

    slopes = np.asarray(jax.grad(pull)(points))
    assert not np.any(slopes[:2])
    assert slopes[2, 0] > 0 and slopes[3, 1] < 0
    # In the image, twice the distance costs twice as much: 0.4·1.875/2 is 0.375.
    alone = pull(jnp.array([[0.4, 0.0, 0.0]]))
    assert float(alone) == pytest.approx(0.375 - 0.2, abs=0.03)  # of 24 pixels


def test_points_beside_the_image_are_told_the_way_to_it():
    outside = measure_outside(draw_disc())

    def pull(x):
        point = jnp.stack([x, jnp.zeros(()), jnp.zeros(())])[None]
        return pull_inside(point, AHEAD, outside, camera=Camera())

    border, far = pull(jnp.array(0.5)), pull(jnp.array(0.9))
    assert float(far - border) == pytest.approx(0.4 * 1.875 / 2, abs=0.03)
    assert float(jax.grad(pull)(jnp.array(0.9))) == pytest.approx(1.875 / 2)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_gradient_is_that_of_finite_differences(projection):
    camera = Camera(projection=projection)
    outside = measure_outside(draw_disc())
    rotation = jnp.array([0.9, 0.1, -0.3, 0.2])
    points = jax.random.uniform(jax.random.key(0), (40, 3), minval=-0.7, maxval=0.7)
    way = jax.random.normal(jax.random.key(1), points.shape)

    def pull(step):
        with jax.enable_x64(True):
            moved = np.asarray(points, np.float64) + step * np.asarray(way, np.float64)
            return float(
                pull_inside(
                    jnp.asarray(moved),
                    jnp.asarray(rotation, jnp.float64),
                    outside.astype(jnp.float64),
                    camera=camera,
                )
            )

    slopes = jax.grad(
        lambda p: pull_inside(p, quaternion.normalize(rotation), outside, camera=camera)
    )(points)
    expected = (pull(1e-6) - pull(-1e-6)) / 2e-6
    assert float(jnp.sum(slopes * way)) == pytest.approx(expected, rel=1e-3)


def test_nothing_is_told_behind_the_camera_and_of_an_empty_view():
    outside = measure_outside(draw_disc())
    behind = jnp.array([[0.1, 0.2, -2.0], [0.1, 0.2, -2.05], [3.0, 0.1, -5.0]])
    value, slopes = jax.value_and_grad(
        lambda p: pull_inside(p, AHEAD, outside, camera=Camera())
    )(behind)
    assert float(value) == 0 and not np.any(slopes)
    nothing = measure_outside(jnp.zeros((8, 8)))
    assert np.isfinite(nothing).all() and np.ptp(nothing) == 0


def test_a_batch_is_the_mean_of_its_views_and_moves_points_alone():
    points = jax.random.uniform(jax.random.key(0), (2, 30, 3), minval=-0.5, maxval=0.5)
    rotations = jax.random.normal(jax.random.key(1), (2, 3, 4))
    masks = np.zeros((2, 3, 16, 16), np.uint8)
    masks[..., 5:11, 6:9] = 255
    moved = 0.1 * jax.random.normal(jax.random.key(2), (2, 3, 3))

    def pull(points, rotations, moved):
        cameras = Cameras(moved, None)
        return pull_batch(
            points, rotations, masks, side=8, camera=Camera(), cameras=cameras
        )

    small = jnp.asarray(masks[0, 0], jnp.float32).reshape(8, 2, 8, 2).mean((1, 3)) / 255
    single = [
        pull_inside(
            points[row],
            rotations[row, view],
            measure_outside(small),
            camera=Camera(),
            translation=moved[row, view],
        )
        for row in range(2)
        for view in range(3)
    ]
    args = points, rotations, moved
    assert float(pull(*args)) == pytest.approx(float(np.mean(single)), rel=1e-5)
    by_points, by_rotations, by_moved = jax.grad(pull, (0, 1, 2))(*args)
    assert np.any(by_points) and not np.any(by_rotations) and not np.any(by_moved)


def test_a_training_step_has_it_where_it_is_asked_for():
    """From a share of the run on: of 20 steps half are before it."""
    config = tiny_config(pull_weight=0.1)
    network = make_network(config)
    step = make_step(network, config)
    early, late = make_state(network, config), make_state(network, config)
    late = late._replace(step=jnp.asarray(10, jnp.int32))
    assert float(step(early, make_batch())[1]["pull"]) == 0
    assert float(step(late, make_batch())[1]["pull"]) > 0
