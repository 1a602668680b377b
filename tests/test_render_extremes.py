"""`project` at its singular places: at the eye, behind it, far away, without points."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render import kernels

ALL = ("silhouette", "depth", "color")


@functools.partial(jax.jit, static_argnames="projection")
def differentiate_total(points, rotation, distance, projection="perspective"):
    def total(points, rotation, distance):
        image = dpc_jax.project(
            points,
            rotation,
            sigma=1.0,
            colors=jnp.ones((len(points), 1)),
            camera=dpc_jax.Camera(1.875, distance, projection),
            grid=dpc_jax.VoxelGrid(8),
            signals=ALL,
        )
        return sum(jnp.sum(image[name] ** 2) for name in ALL), image

    differentiate = jax.value_and_grad(total, argnums=(0, 1, 2), has_aux=True)
    (_, image), gradients = differentiate(points, rotation, distance)
    return image, gradients


IDENTITY = jnp.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("z", [-2.0, -2.0 - 1e-7, -2.0 + 1e-7, -5.0, 1e6, 1e30])
def test_points_at_and_behind_the_camera_leave_no_trace_and_no_nan(z):
    points = jnp.array([[0.0, 0.0, z], [1e-3, 0.0, z]])
    image, gradients = differentiate_total(points, IDENTITY, 2.0)
    assert np.all(np.asarray(image.silhouette) == 0)
    assert np.all(np.asarray(image.depth) == 10) and np.all(
        np.asarray(image.color) == 1
    )
    for gradient in gradients:
        assert np.all(np.asarray(gradient) == 0)


@pytest.mark.parametrize("z", [0.0, 1e-30, 1e-20, 1e-7, 1e-5])
def test_a_point_at_the_eye_spoils_no_other_gradient(z):
    # The camera stands in the volume; 1/z² of a point at 1e-20 overflows float32.
    other = [0.01, 0.02, 0.3]
    near = jnp.array([[0.0, 0.0, z], [1e-3, 0.0, z], other])
    _, gradients = differentiate_total(near, IDENTITY, 0.0)
    for gradient in gradients:
        assert np.all(np.isfinite(gradient))
    if z < 1e-6:  # without an image, so as if behind the camera
        _, alone = differentiate_total(near.at[:2, 2].set(-1.0), IDENTITY, 0.0)
        for gradient, expected in zip(gradients, alone, strict=True):
            np.testing.assert_array_equal(gradient, expected)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("size", [1e10, 1e20, 1e30])
def test_far_points_leave_no_trace_and_finite_gradients(size, projection):
    points = jnp.array([[size, size, -size], [-size, size, size], [0.0, size, 0.0]])
    image, gradients = differentiate_total(
        points, jnp.array([0.3, 0.4, 0.5, 0.6]), 2.0, projection
    )
    assert np.all(np.asarray(image.silhouette) == 0)
    for gradient in gradients:
        assert np.all(np.asarray(gradient) == 0)


@pytest.mark.parametrize("count", [0, 1])
def test_a_cloud_of_no_or_one_point_has_its_images(count):
    image, _ = differentiate_total(jnp.zeros((count, 3)), IDENTITY, 2.0)
    assert image.silhouette.shape == image.depth.shape == (8, 8)
    assert image.color.shape == (8, 8, 1)
    assert (np.max(image.silhouette) > 0) == (count > 0)
    assert np.all(np.isfinite(image.depth))


@pytest.mark.parametrize("size", ["sigma", "covariance"])
def test_a_point_of_mass_zero_has_the_gradient_of_its_mass(size):
    points = jnp.array([[0.1, 0.05, 0.0], [-0.2, 0.1, 0.1]])
    sizes = {"sigma": None, "covariance": None}
    sizes[size] = jnp.ones(2) if size == "sigma" else jnp.stack([jnp.eye(3)] * 2)

    def total(scale):
        image = dpc_jax.project(
            points, IDENTITY, **sizes, scale=scale, grid=dpc_jax.VoxelGrid(8)
        )
        return jnp.sum(image.silhouette)

    gradient = jax.jit(jax.grad(total))
    without = gradient(jnp.array([0.5, 0.0]))
    # Silhouettes are polynomials in a mass: next to nothing has next to that gradient.
    np.testing.assert_allclose(without, gradient(jnp.array([0.5, 1e-6])), rtol=1e-4)
    assert without[1] > 0.5


def test_a_kernel_at_its_floor_has_a_finite_slope_in_float16():
    # 1/σ² of the floor is 2500, and 65504 the largest float16. The offsets were found
    # by a search over 20000; the weight of the nearest cell is what overflowed.
    cells = jnp.arange(8, dtype=jnp.float16)

    @jax.jit
    def differentiate(sigma, center):
        def total(sigma, center):
            weights = kernels.sample_gaussian(cells, sigma, center=center)
            return jnp.sum(weights * 1.5)

        return jax.grad(total, argnums=(0, 1))(sigma, center)

    for center in (-0.4849, 2.479, -0.3442, 3.27, 4.68):
        for sigma in (0.0, 0.02):
            slopes = differentiate(jnp.float16(sigma), jnp.float16(center))
            assert np.all(np.isfinite(slopes)), (center, sigma)
