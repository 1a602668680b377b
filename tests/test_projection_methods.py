"""Which method "auto" takes, and how near the fast methods come to the basic one."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render.fast import splatting

COUNT = 500
RNG = np.random.default_rng(1)
POINTS = jnp.asarray(RNG.normal(size=(COUNT, 3)) * 0.12, "f4")
COLORS = jnp.asarray(RNG.uniform(size=(COUNT, 2)), "f4")
POSE = jnp.array([0.9, 0.1, -0.3, 0.2])


@functools.partial(jax.jit, static_argnames="method")
def differentiate(sigma, method):
    """Gradients to points and sizes, and the images."""

    def measure(points, sigma):
        images = dpc_jax.project(
            points,
            POSE,
            sigma=sigma,
            colors=COLORS,
            grid=dpc_jax.VoxelGrid(40),
            signals=("silhouette", "depth", "color"),
            method=method,
        )
        loss = jnp.sum((images.silhouette - 0.5) ** 2) + jnp.sum(images.color**2)
        return loss, images

    return jax.grad(measure, (0, 1), has_aux=True)(POINTS, sigma)


def find_errors(found, right):
    """Largest relative error of an image, and those of both gradients."""

    def compare(a, b):
        return float(jnp.linalg.norm(a - b) / jnp.linalg.norm(b))

    to_points, _, *images = jax.tree.leaves(jax.tree.map(compare, found, right))
    return max(images), to_points


@pytest.mark.parametrize(
    "method, sigma, image, by_points",
    # About one and a half times what is measured.
    [
        ("quadratic", 1.6, 7e-4, 0.007),
        ("cubic", 1.6, 3e-4, 0.0012),
    ],
)
def test_images_and_gradients_come_near_to_those_of_gaussians(
    method, sigma, image, by_points
):
    right = differentiate(sigma, "gaussian")
    found = find_errors(differentiate(sigma, method), right)
    assert found[0] < image and found[1] < by_points
    # The trilinear method is not within these bounds.
    plain = find_errors(differentiate(sigma, "trilinear"), right)
    assert plain[0] > image and plain[1] > by_points


def test_auto_is_the_fast_method_for_one_sigma_and_the_basic_one_for_several():
    def write(method, **size):
        def render(size):
            return dpc_jax.project(POINTS, POSE, **size, method=method)

        return jax.jit(render).lower(size).as_text()

    one, several = {"sigma": jnp.float32(1)}, {"sigma": jnp.ones(COUNT)}
    matrices = {"covariance": jnp.ones((COUNT, 3, 3))}
    assert write("auto", **one) == write("trilinear", **one)
    assert write("auto", **one) != write("gaussian", **one)
    assert write("auto", **several) == write("gaussian", **several)
    assert write("auto", **matrices) == write("gaussian", **matrices)


@pytest.mark.parametrize("sigma", [0.0, splatting.find_least(3)])
def test_a_traced_sigma_below_the_splines_own_draws_the_spline(sigma):
    gradients, images = differentiate(sigma, "cubic")
    _, right = differentiate(splatting.find_least(3) - 1e-3, "cubic")
    np.testing.assert_array_equal(images.silhouette, right.silhouette)
    assert np.isfinite(gradients[1])
