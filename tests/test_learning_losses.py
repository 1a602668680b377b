"""Losses; the stability cases hold most of them to their oracles and limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from tiny_runs import make_batch, make_recipe, random_quaternions, tiny_config

from dpc_jax.learning.losses import (
    measure_outside,
    pull_inside,
    reprojection_loss,
    repulsion_energy,
    student_loss,
)
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import downsample_images
from dpc_jax.measure.stability import oracles
from dpc_jax.render import Camera, VoxelGrid
from dpc_jax.render.camera import to_camera_frame, to_grid

# float64 oracles against float32 results of order one: a few ulps of 6e-8.
ROUNDING = 1e-6
TEACHER = random_quaternions(3)
AHEAD = jnp.array([1.0, 0, 0, 0])


def turn(quaternion, angle_deg):
    """The rotation after a turn about a unit axis, in extended precision."""
    half = np.radians(np.longdouble(angle_deg)) / 2
    axis = np.sin(half) * np.array([0.6, 0.0, 0.8])
    found = oracles.multiply(np.array([np.cos(half), *axis]), quaternion)
    return np.asarray(found, np.float64)


@pytest.mark.parametrize("angle", [0.0, 60.0, 120.0, 180.0])
def test_the_papers_and_the_released_codes_forms_of_the_student_loss(angle):
    cosine = np.cos(np.radians(angle) / 2)
    student = turn(TEACHER, angle)
    forms = {"absolute": 1 - cosine, "signed": 1 - cosine, "squared": 1 - cosine**2}
    for form, expected in forms.items():
        loss = student_loss(jnp.asarray(student), jnp.asarray(TEACHER), form=form)
        assert float(loss) == pytest.approx(expected, abs=ROUNDING)
    # Only the form of the text punishes the other sign of the same rotation.
    loss = student_loss(jnp.asarray(-student), jnp.asarray(TEACHER), form="signed")
    assert float(loss) == pytest.approx(1 + cosine, abs=ROUNDING)


def test_images_of_other_shapes_and_single_points_are_refused():
    with pytest.raises(ValueError, match=r"target.*\[8, 8\].*\[8, 8, 1\]"):
        reprojection_loss(jnp.zeros((8, 8)), jnp.zeros((8, 8, 1)))
    with pytest.raises(ValueError, match="two points.*1"):
        repulsion_energy(jnp.zeros((1, 3)))


# The pull on points outside of silhouettes.


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
    below = np.nextafter(np.float32(0.5), np.float32(0))  # half, on some devices
    half = jnp.zeros((4, 4)).at[1, 1].set(below).at[3, 3].set(0.49)  # of a pixel
    assert float(measure_outside(half)[3, 3]) == pytest.approx(np.sqrt(8) / 4)
    nothing = measure_outside(jnp.zeros((8, 8)))
    assert np.isfinite(nothing).all() and np.ptp(nothing) == 0


def test_points_outside_are_told_the_way_in_and_those_inside_nothing():
    outside = measure_outside(draw_disc())

    def pull(points):
        return pull_inside(jnp.asarray(points), AHEAD, outside, camera=Camera())

    points = [[0.0, 0, 0], [0.05, -0.05, 0.2], [0.4, 0, 0], [0, -0.3, 0.1]]
    slopes = np.asarray(jax.grad(pull)(jnp.array(points)))
    assert not np.any(slopes[:2])
    assert slopes[2, 0] > 0 and slopes[3, 1] < 0
    # In the image 0.4·1.875/2 is 0.375, of 24 pixels; beside it, it goes on alike.
    assert float(pull([[0.4, 0.0, 0.0]])) == pytest.approx(0.375 - 0.2, abs=0.03)
    beside = float(pull([[0.9, 0.0, 0.0]]) - pull([[0.5, 0.0, 0.0]]))
    assert beside == pytest.approx(0.4 * 1.875 / 2, abs=0.03)
    # Behind the camera, or just before it, nothing.
    behind = jnp.array([[0.1, 0.2, -2.0], [0.1, 0.2, -2.05], [3.0, 0.1, -5.0]])
    value, slopes = jax.value_and_grad(pull)(behind)
    assert float(value) == 0 and not np.any(slopes)


@pytest.mark.parametrize(
    "camera",
    [Camera(), Camera(projection="orthographic")]
    + [Camera(1.5, principal_point=np.array([0.1, -0.2]), aspect=1.3)],
)
def test_a_point_is_pulled_from_where_it_is_drawn(camera):
    point = jnp.array([[0.21, 0.13, 0.1]])
    moved = to_camera_frame(point, AHEAD, None)
    row, column, _ = to_grid(moved, camera=camera, grid=VoxelGrid(24))[0][0]
    slope = jnp.array([0.3, 0.7])  # of a map that differs in every pixel
    outside = slope[0] * jnp.arange(24)[:, None] + slope[1] * jnp.arange(24)[None]
    found = pull_inside(point, AHEAD, outside, camera=camera)
    assert float(found) == pytest.approx(float(slope @ jnp.stack([row, column])), 1e-5)


def test_a_batch_is_pulled_by_the_mean_of_its_views_and_moves_points_alone():
    """From half of a run on: of 20 steps from the tenth."""
    recipe = make_recipe(tiny_config(pull_weight=0.1))
    points = jax.random.uniform(jax.random.key(0), (4, 30, 3), minval=-0.5, maxval=0.5)
    rotations = jax.random.normal(jax.random.key(1), (4, 4))
    moved = 0.1 * jax.random.normal(jax.random.key(2), (4, 3))
    batch, one = {"masks": make_batch()["masks"].reshape(4, 16, 16)}, jnp.ones(4)

    def pull(points, rotations, moved, step=10):
        shapes = Points(points, points, None, one, one, jnp.ones(()))
        views = {"rotation": rotations, "translation": moved}
        terms = shapes.find_pulls(views, batch, step, recipe=recipe)
        assert terms["pull"].weight == pytest.approx(0.1 * 8**2)
        return terms["pull"].value

    single = [
        pull_inside(
            points[at],
            rotations[at],
            measure_outside(downsample_images(batch["masks"][at], 8)),
            camera=Camera(),
            translation=moved[at],
        )
        for at in range(4)
    ]
    args = points, rotations, moved
    assert float(pull(*args)) == pytest.approx(float(np.mean(single)), rel=1e-5)
    assert float(pull(*args, step=9)) == 0
    by_points, by_rotations, by_moved = jax.grad(pull, (0, 1, 2))(*args)
    assert np.any(by_points) and not np.any(by_rotations) and not np.any(by_moved)
