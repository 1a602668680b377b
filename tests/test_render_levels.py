"""A size for each point as a mixture of a few shared ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render.fast import levels

RNG = np.random.default_rng(3)
POINTS = jnp.asarray(RNG.normal(size=(600, 3)) * 0.12, "f4")
COLORS = jnp.asarray(RNG.uniform(size=(600, 2)), "f4")
POSE = jnp.array([0.9, 0.1, -0.3, 0.2])


@jax.jit
def find_both(sigma):
    """Images and gradients of points and sizes, by the levels and by the Gaussians."""

    def render(inputs, method):
        points, sigma = inputs
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
        return loss, (images.silhouette, images.depth, images.color)

    def find(method):
        return jax.grad(lambda x: render(x, method), has_aux=True)((POINTS, sigma))

    return find("levels"), find("gaussian")


def measure(found, right):
    return [
        float(jnp.linalg.norm(a - b) / jnp.linalg.norm(b))
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True)
    ]


@pytest.mark.parametrize(
    "ratio, image, by_points, by_sizes",
    # About one and a half times what is measured.
    [(1.0, 0.02, 0.1, 0.6), (3.6, 0.005, 0.02, 0.07), (8.0, 0.005, 0.02, 0.1)],
)
def test_images_and_gradients_come_near_to_those_of_gaussians(
    ratio, image, by_points, by_sizes
):
    """A narrowest sigma of 0.8 voxels; what is left at equal sizes is the splines'."""
    sizes = jnp.asarray(0.8 * ratio ** RNG.uniform(0, 1, 600), "f4")
    to_points, to_sizes, *images = measure(*find_both(sizes))
    assert max(images) < image
    assert to_points < by_points and to_sizes < by_sizes


def test_weights_of_a_point_sum_to_one_and_are_its_own_at_the_ends():
    sizes = jnp.array([0.7, 1.0, 1.9, 2.8, 0.01, 99.0])
    is_inside = jnp.array([True] * 5 + [False])
    found, weights = levels.find_levels(sizes, is_inside)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(
        found[jnp.array([0, -1])], [levels.LEAST, 2.8], rtol=1e-5
    )
    # The largest inside, and one below what a spline can draw.
    ends = jax.nn.one_hot(jnp.array([5, 0]), 6)
    np.testing.assert_allclose(weights[jnp.array([3, 4])], ends, atol=1e-5)


@pytest.mark.parametrize("value", [0.0, 1e-3, 1e3, np.inf, np.nan])
def test_one_odd_size_among_traced_ones_leaves_no_wrong_image_of_the_others(value):
    """A NaN is seen; what is too small or too large draws something finite."""
    sizes = jnp.ones(600).at[7].set(value)
    (gradients, images), _ = find_both(sizes)
    is_finite = [bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(images)]
    assert all(is_finite) == bool(np.isfinite(value))
    if np.isfinite(value):
        assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(gradients))


@pytest.mark.parametrize(
    "options, words",
    [
        ({"sigma": jnp.array([0.5, 1, 2, 4.5])}, "a factor of at most 8"),
        ({"covariance": jnp.ones((4, 3, 3)), "sigma": None}, "has no covariance"),
        ({"sigma": jnp.ones(4), "max_blocks": 9}, "one sigma for all points"),
    ],
)
def test_what_levels_cannot_draw_is_refused(options, words):
    with pytest.raises(ValueError, match=words):
        dpc_jax.project(jnp.zeros((4, 3)), POSE, method="levels", **options)
