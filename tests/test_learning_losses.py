"""The losses against numpy, and the student's loss at its singular points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import random_quaternions

from dpc_jax.learning.losses import (
    containment_loss,
    downsample_images,
    geodesic_loss,
    reprojection_loss,
    repulsion_energy,
    student_loss,
)

# float64 oracles against float32 results of order one: a few ulps of 6e-8.
ROUNDING = 1e-6

differentiate = jax.jit(jax.value_and_grad(student_loss, argnums=(0, 1)))
TEACHER = random_quaternions(3)


def turn(quaternion, axis, angle_deg):
    """Hamilton product with a turn about a unit axis, in float64."""
    half = np.radians(angle_deg) / 2
    w, v = np.cos(half), np.sin(half) * np.asarray(axis, np.float64)
    v2 = quaternion[1:]
    return np.array(
        [w * quaternion[0] - v @ v2, *(w * v2 + quaternion[0] * v + np.cross(v, v2))]
    )


@pytest.mark.parametrize("angle", [0.0, 1.0, 60.0, 179.0])
def test_the_student_loss_is_one_minus_the_cosine_of_half_the_angle(angle):
    student = turn(TEACHER, [0.6, 0.0, 0.8], angle)
    loss, _ = differentiate(student, TEACHER)
    assert loss == pytest.approx(1 - np.cos(np.radians(angle) / 2), abs=ROUNDING)


def test_the_student_loss_ignores_sign_and_length_of_either_quaternion():
    a, b = random_quaternions(1, 2)
    expected = float(differentiate(a, b)[0])
    for left, right in [(-a, b), (a, -b), (-a, -b), (7 * a, b), (a, 1e-20 * b)]:
        assert differentiate(left, right)[0] == pytest.approx(expected, abs=ROUNDING)


def test_the_teacher_gets_no_gradient():
    a, b = random_quaternions(1, 2)
    _, (to_student, to_teacher) = differentiate(a, b)
    assert np.linalg.norm(to_student) > 0.1
    np.testing.assert_array_equal(to_teacher, 0)


def test_the_student_loss_agrees_with_finite_differences():
    a, b = random_quaternions(5, 2)

    def loss(q):
        return 1 - abs(q @ b) / np.linalg.norm(q)

    step = 1e-5  # error 1e-10 of the central difference, far below float32's
    expected = [
        (loss(a + step * e) - loss(a - step * e)) / (2 * step) for e in np.eye(4)
    ]
    _, (gradient, _) = differentiate(a, b)
    np.testing.assert_allclose(gradient, expected, atol=ROUNDING)


@pytest.mark.parametrize("offset", [0.0, 1e-7, -1e-7])
def test_at_180_degrees_the_gradient_is_of_length_one_and_leads_to_the_teacher(offset):
    # Exactly orthogonal quaternions, where 1 - cos² of the released code has none.
    student = np.array([offset, 1.0, 0.0, 0.0])
    teacher = np.array([1.0, 0.0, 0.0, 0.0])
    loss, (gradient, _) = differentiate(student, teacher)
    assert loss == pytest.approx(1, abs=ROUNDING)
    sign = -1 if offset >= 0 else 1
    np.testing.assert_allclose(gradient, sign * teacher, atol=ROUNDING)
    assert differentiate(student - 0.1 * np.asarray(gradient), teacher)[0] < loss


@pytest.mark.parametrize("offset", [0.0, 1e-7])
def test_at_zero_degrees_loss_and_gradient_vanish(offset):
    teacher = np.array([0.0, 0.6, 0.8, 0.0])
    loss, (gradient, _) = differentiate(teacher + [offset, 0, 0, 0], teacher)
    assert loss == pytest.approx(0, abs=ROUNDING)
    np.testing.assert_allclose(gradient, 0, atol=ROUNDING)


def test_a_zero_quaternion_gives_a_finite_loss_and_gradient():
    loss, gradients = differentiate(np.zeros(4), TEACHER)
    assert np.isfinite(loss) and np.all(np.isfinite(gradients[0]))


@pytest.mark.parametrize("angle", [0.0, 60.0, 120.0, 180.0])
def test_the_papers_and_the_released_codes_forms_of_the_student_loss(angle):
    cosine = np.cos(np.radians(angle) / 2)
    student = turn(TEACHER, [0.6, 0.0, 0.8], angle)
    forms = {"absolute": 1 - cosine, "signed": 1 - cosine, "squared": 1 - cosine**2}
    for form, expected in forms.items():
        loss = student_loss(jnp.asarray(student), jnp.asarray(TEACHER), form=form)
        assert float(loss) == pytest.approx(expected, abs=ROUNDING)
    # Only the form of the text punishes the other sign of the same rotation.
    loss = student_loss(jnp.asarray(-student), jnp.asarray(TEACHER), form="signed")
    assert float(loss) == pytest.approx(1 + cosine, abs=ROUNDING)


differentiate_geodesic = jax.jit(jax.value_and_grad(geodesic_loss, argnums=(0, 1)))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0, 90.0, 179.0, 180.0])
def test_the_geodesic_loss_is_the_angle_whatever_the_signs(angle, sign):
    predicted = turn(TEACHER, [0.6, 0.0, 0.8], angle)
    loss, (gradient, to_label) = differentiate_geodesic(sign * predicted, TEACHER)
    # float32 inputs: an angle of a few ulps near 0 and near 180 degrees.
    assert float(loss) == pytest.approx(np.radians(angle), abs=3e-6)
    assert np.all(np.isfinite(gradient))
    np.testing.assert_array_equal(to_label, 0)
    if 0.1 < angle:
        # 2 over the length of the prediction, at every angle.
        assert np.linalg.norm(gradient) == pytest.approx(2, rel=1e-3)
        step = sign * predicted - 1e-3 * np.asarray(gradient)
        assert differentiate_geodesic(step, TEACHER)[0] < loss


@pytest.mark.parametrize("offset", [0.0, 1e-7, -1e-7])
def test_at_half_a_turn_the_geodesic_gradient_leads_to_the_label_of_one_sign(offset):
    predicted, label = np.array([offset, 1.0, 0, 0]), np.array([1.0, 0, 0, 0])
    loss, (gradient, _) = differentiate_geodesic(predicted, label)
    assert float(loss) == pytest.approx(np.pi, abs=ROUNDING)
    sign = -1 if offset >= 0 else 1
    np.testing.assert_allclose(gradient, 2 * sign * label, atol=ROUNDING)


@pytest.mark.parametrize("sign", [1, -1])
def test_at_no_turn_the_geodesic_gradient_is_zero(sign):
    label = np.array([0.0, 0.6, 0.8, 0.0])
    loss, (gradient, _) = differentiate_geodesic(sign * label, label)
    assert float(loss) == 0
    np.testing.assert_array_equal(gradient, np.zeros(4))


def test_the_reprojection_loss_is_the_sum_of_squared_differences():
    a, b = np.random.default_rng(0).random((2, 8, 8))
    expected = np.sum((a - b) ** 2)
    # 64 terms in float32.
    assert reprojection_loss(jnp.array(a), jnp.array(b)) == pytest.approx(
        expected, rel=1e-5
    )


def test_the_reprojection_loss_does_not_broadcast():
    with pytest.raises(ValueError, match=r"target.*\[8, 8\].*\[8, 8, 1\]"):
        reprojection_loss(jnp.zeros((8, 8)), jnp.zeros((8, 8, 1)))


@pytest.mark.parametrize("size", [16, 8, 4, 1])
def test_masks_are_averaged_over_blocks_of_pixels(size):
    masks = np.random.default_rng(0).integers(0, 256, (2, 3, 16, 16), np.uint8)
    small = downsample_images(masks, size)
    assert small.shape == (2, 3, size, size)
    f = 16 // size
    for i, j in [(0, 0), (size - 1, 0), (size // 2, size - 1)]:
        block = masks[..., i * f : (i + 1) * f, j * f : (j + 1) * f] / 255.0
        np.testing.assert_allclose(
            small[..., i, j], block.mean((-1, -2)), atol=ROUNDING
        )


def test_black_stays_zero_and_white_stays_one():
    masks = np.zeros((16, 16), np.uint8)
    masks[:, 8:] = 255
    np.testing.assert_array_equal(downsample_images(masks, 2), [[0, 1], [0, 1]])


def test_repulsion_is_the_mean_of_one_over_the_distance_of_the_pairs():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (9, 3))
    pairs = [
        1 / np.sqrt(np.sum((a - b) ** 2) + 0.02**2)
        for i, a in enumerate(points)
        for j, b in enumerate(points)
        if i != j
    ]
    assert repulsion_energy(jnp.array(points)) == pytest.approx(
        np.mean(pairs), rel=ROUNDING
    )


def test_repulsion_pushes_near_points_apart_and_is_finite_where_they_coincide():
    gradient = jax.grad(repulsion_energy)(jnp.array([[0.0, 0, 0], [0.1, 0, 0]]))
    assert gradient[0, 0] > 0 > gradient[1, 0]
    value, gradient = jax.value_and_grad(repulsion_energy)(jnp.zeros((2, 3)))
    assert value == pytest.approx(1 / 0.02, rel=1e-5)
    np.testing.assert_array_equal(gradient, 0)


def test_containment_is_the_squared_distance_beyond_the_sphere():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3))
    beyond = np.maximum(np.linalg.norm(points, axis=-1) - 0.5, 0)
    assert 5 < np.count_nonzero(beyond) < 35
    value, gradient = jax.value_and_grad(containment_loss)(jnp.array(points))
    assert float(value) == pytest.approx(np.sum(beyond**2), rel=1e-5)
    expected = 2 * beyond[:, None] * points / np.linalg.norm(points, axis=-1)[:, None]
    np.testing.assert_allclose(gradient, expected, atol=ROUNDING)


@pytest.mark.parametrize("point", [[0.0, 0, 0], [0.5, 0, 0], [0.5 + 1e-7, 0, 0]])
def test_containment_is_smooth_at_the_centre_and_on_the_sphere(point):
    value, gradient = jax.value_and_grad(containment_loss)(jnp.array([point]))
    assert float(value) == pytest.approx(0, abs=ROUNDING)
    np.testing.assert_allclose(gradient, 0, atol=ROUNDING)


def test_repulsion_of_points_far_apart_is_not_drowned_by_their_own_terms():
    far = np.array([[0.0, 0, 0], [3e6, 0, 0], [0, 4e6, 0]])
    value, gradient = jax.value_and_grad(repulsion_energy)(jnp.array(far))
    distances = np.array([3e6, 4e6, 5e6])
    assert value == pytest.approx(np.mean(1 / distances), rel=ROUNDING)
    # ∂/∂x of the first point: 1/d² of each of two pairs, of three in the mean.
    expected = [1 / 3e6**2 / 3, 1 / 4e6**2 / 3, 0]
    np.testing.assert_allclose(gradient[0], expected, rtol=ROUNDING)


@pytest.mark.parametrize("far", [1.0, 1e10, 1e30, 3e38])
def test_points_at_either_end_of_the_floats_repel_each_other_by_a_finite_energy(far):
    pair = jnp.array([[far, 0, 0], [-far, 0, 0]], jnp.float32)
    energy, slopes = jax.value_and_grad(repulsion_energy)(pair)
    # 1 / (2r), but for the softening; from 1e38 on it is below the normal floats.
    assert energy == pytest.approx(0.5 / far, rel=1e-3, abs=2e-38)
    assert np.all(np.isfinite(slopes))


def test_a_single_point_has_no_repulsion_and_is_refused():
    with pytest.raises(ValueError, match="two points.*1"):
        repulsion_energy(jnp.zeros((1, 3)))
