"""Gradients of `project` with respect to every input, against finite differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import compiling_quickly

import dpc_jax

GRID = dpc_jax.VoxelGrid((10, 12, 9))
COUNT = 9
SHARED = (
    "points",
    "rotation",
    "matrix",
    "scale",
    "colors",
    "translation",
    "focal_length",
    "distance",
    "background_depth",
    "background_color",
)
CASES = [
    *(("trilinear", name) for name in (*SHARED, "sigma")),
    *(("gaussian", name) for name in (*SHARED, "sigma", "sigmas")),
    *(("covariance", name) for name in (*SHARED, "covariance")),
]


def make_inputs():
    rng = np.random.default_rng(7)
    half = rng.normal(size=(COUNT, 3, 3)) * 0.8
    quaternion = rng.normal(size=4)
    return {
        "points": rng.uniform(-0.3, 0.3, (COUNT, 3)),
        "rotation": quaternion,
        "matrix": np.linalg.qr(rng.normal(size=(3, 3)))[0],
        "scale": rng.uniform(0.5, 3, COUNT),
        "colors": rng.uniform(size=(COUNT, 2)),
        "translation": np.array([0.02, -0.03, 0.04]),
        "focal_length": np.array(1.8),
        "distance": np.array(2.1),
        "background_depth": np.array(5.0),
        "background_color": np.array([0.2, 0.9]),
        "sigma": np.array(1.1),
        "sigmas": rng.uniform(0.4, 2, COUNT),
        "covariance": half @ half.transpose(0, 2, 1) + 0.3 * np.eye(3),
    }


def weigh(images):
    """A sum over every pixel of every image, each with a weight of its own."""
    return sum(
        jnp.sum(i * jnp.cos(jnp.arange(i.size)).reshape(i.shape)) for i in images
    )


def measure(inputs, method, turn, size):
    """A number that depends on every pixel of every signal."""
    image = dpc_jax.project(
        inputs["points"],
        inputs[turn],
        sigma=None if size == "covariance" else inputs[size],
        covariance=inputs["covariance"] if size == "covariance" else None,
        scale=inputs["scale"],
        colors=inputs["colors"],
        translation=inputs["translation"],
        camera=dpc_jax.Camera(inputs["focal_length"], inputs["distance"]),
        grid=GRID,
        signals=("silhouette", "depth", "color"),
        method="auto" if size == "covariance" else method,
        background_depth=inputs["background_depth"],
        background_color=inputs["background_color"],
    )
    return weigh([image.silhouette, image.depth, image.color])


# Values and gradients to all inputs in one program: it compiles once for each choice of
# method, turn and size.
differentiate = jax.jit(
    jax.value_and_grad(measure), static_argnames=("method", "turn", "size")
)


def compare_slopes(differentiate, inputs, name, away, step):
    """Slope of a function along a direction: its gradient's, and by differences."""
    _, gradients = differentiate(inputs)
    sides = [
        float(differentiate(inputs | {name: inputs[name] + by * away})[0])
        for by in (step, -step)
    ]
    gradient = np.asarray(gradients[name])
    assert np.any(gradient != 0)
    return np.sum(gradient * away), (sides[0] - sides[1]) / (2 * step)


@pytest.mark.parametrize(("method", "name"), CASES)
def test_the_gradient_equals_finite_differences_in_float64(method, name):
    size = {"covariance": "covariance"}.get(method, "sigma")
    function = functools.partial(
        differentiate,
        method=method,
        turn="matrix" if name == "matrix" else "rotation",
        size="sigmas" if name == "sigmas" else size,
    )
    with jax.enable_x64(True), compiling_quickly():
        inputs = {k: jnp.asarray(v) for k, v in make_inputs().items()}
        away = np.random.default_rng(1).normal(size=inputs[name].shape)
        if name == "covariance":
            away = away + away.transpose(0, 2, 1)
        slope, numeric = compare_slopes(function, inputs, name, away, 1e-6)
    # Differences of a sum of order 100 with rounding 1e-14, over 2e-6.
    assert slope == pytest.approx(numeric, rel=1e-6, abs=2e-6)


@functools.partial(jax.jit, static_argnames=("method", "ray_rule"))
def render(inputs, method="trilinear", ray_rule="termination"):
    """Silhouette and occupancies of the same call."""
    options = {"sigma": inputs["sigma"], "scale": inputs["scale"]}
    options |= {"grid": GRID, "method": method}
    where = inputs["points"], inputs["rotation"]
    image = dpc_jax.project(*where, **options, ray_rule=ray_rule)
    return image.silhouette, dpc_jax.voxelize(*where, **options)


@pytest.mark.parametrize("name", ["points", "sigma", "scale"])
def test_the_maximum_along_a_ray_has_the_gradient_of_the_fullest_cell(name):
    with jax.enable_x64(True), compiling_quickly():
        inputs = {k: jnp.asarray(v) for k, v in make_inputs().items()}
        away = np.random.default_rng(2).normal(size=inputs[name].shape)
        slope, numeric = compare_slopes(differentiate_maximum, inputs, name, away, 1e-7)
    assert slope == pytest.approx(numeric, rel=1e-5, abs=1e-5)


@jax.jit
@jax.value_and_grad
def differentiate_maximum(inputs):
    return weigh(render(inputs, ray_rule="maximum")[:1])


def make_single():
    return {k: jnp.asarray(v, "f4") for k, v in make_inputs().items()}


def test_the_maximum_along_a_ray_is_that_of_its_occupancies():
    with compiling_quickly():
        silhouette, occupancy = render(make_single(), ray_rule="maximum")
    np.testing.assert_array_equal(silhouette, np.max(occupancy, axis=-1))


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
def test_a_volume_and_its_terminations_give_the_silhouette(method):
    with compiling_quickly():
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
    with compiling_quickly():
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
