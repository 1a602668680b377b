"""The ray rules of `project`, its volume beside its images, and colours one by one."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax

GRID = dpc_jax.VoxelGrid((10, 12, 9))
COUNT = 9


def make_inputs():
    rng = np.random.default_rng(7)
    return {
        "points": rng.uniform(-0.3, 0.3, (COUNT, 3)),
        "rotation": rng.normal(size=4),
        "scale": rng.uniform(0.5, 3, COUNT),
        "sigma": np.array(1.1),
    }


@functools.partial(jax.jit, static_argnames=("method", "ray_rule"))
def render(inputs, method="trilinear", ray_rule="termination"):
    """Silhouette and occupancies of the same call."""
    options = {"sigma": inputs["sigma"], "scale": inputs["scale"]}
    options |= {"grid": GRID, "method": method}
    where = inputs["points"], inputs["rotation"]
    image = dpc_jax.project(*where, **options, ray_rule=ray_rule)
    return image.silhouette, dpc_jax.voxelize(*where, **options)


def make_single():
    return {k: jnp.asarray(v, "f4") for k, v in make_inputs().items()}


def test_the_maximum_along_a_ray_is_that_of_its_occupancies():
    silhouette, occupancy = render(make_single(), ray_rule="maximum")
    np.testing.assert_array_equal(silhouette, np.max(occupancy, axis=-1))


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
def test_a_volume_and_its_terminations_give_the_silhouette(method):
    silhouette, occupancy = render(make_single(), method=method)
    assert occupancy.shape == GRID.shape
    ends, background = dpc_jax.termination_probabilities(occupancy)
    # Rounding of a sum and a product over nine cells.
    np.testing.assert_allclose(ends.sum(-1), silhouette, atol=1e-6)
    np.testing.assert_allclose(1 - background, silhouette, atol=1e-6)


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
@pytest.mark.parametrize("channels", [1, 3, 7])
def test_colours_of_any_number_of_channels_come_one_by_one(method, channels):
    colors = np.random.default_rng(4).uniform(size=(COUNT, channels)).astype("f4")
    image = render_colors(make_single(), colors, method)
    assert image.shape == (10, 12, channels)
    for i in range(0, channels, 3):
        one = render_colors(make_single(), colors[:, i : i + 1], method)
        np.testing.assert_allclose(image[..., i], one[..., 0], atol=1e-6)


@functools.partial(jax.jit, static_argnames="method")
def render_colors(inputs, colors, method):
    return dpc_jax.project(
        inputs["points"],
        inputs["rotation"],
        sigma=inputs["sigma"],
        scale=inputs["scale"],
        colors=colors,
        grid=GRID,
        signals=("color",),
        method=method,
    ).color
