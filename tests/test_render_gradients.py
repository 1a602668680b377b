"""Gradients of `project` with respect to every input, against finite differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

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


@functools.partial(jax.jit, static_argnames=("method", "turn", "size"))
def measure(inputs, method, turn, size):
    """A weighted sum of every pixel of every image."""
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
    images = [image.silhouette, image.depth, image.color]
    return sum(
        jnp.sum(i * jnp.cos(jnp.arange(i.size)).reshape(i.shape)) for i in images
    )


slope = functools.partial(jax.jit, static_argnames=("method", "turn", "size"))(
    jax.grad(measure)
)


@pytest.mark.parametrize(("method", "name"), CASES)
def test_the_gradient_equals_finite_differences_in_float64(method, name):
    size = {"covariance": "covariance"}.get(method, "sigma")
    size = "sigmas" if name == "sigmas" else size
    options = {
        "method": method,
        "turn": "matrix" if name == "matrix" else "rotation",
        "size": size,
    }
    rng = np.random.default_rng(1)
    with jax.enable_x64(True):
        inputs = {k: jnp.asarray(v) for k, v in make_inputs().items()}
        gradient = np.asarray(slope(inputs, **options)[name])
        away = rng.normal(size=gradient.shape)
        if name == "covariance":
            away = away + away.transpose(0, 2, 1)
        step = 1e-6

        def move(by):
            return float(measure(inputs | {name: inputs[name] + by * away}, **options))

        numeric = (move(step) - move(-step)) / (2 * step)
    # Differences of a sum of order 100 with rounding 1e-14, over 2e-6.
    assert np.sum(gradient * away) == pytest.approx(numeric, rel=1e-6, abs=2e-6)
    assert np.any(gradient != 0)


@pytest.mark.parametrize("name", ["points", "sigma", "scale"])
def test_the_maximum_along_a_ray_has_the_gradient_of_the_fullest_cell(name):
    rng = np.random.default_rng(2)

    @jax.jit
    def measure_maximum(inputs):
        silhouette = dpc_jax.project(
            inputs["points"],
            inputs["rotation"],
            sigma=inputs["sigma"],
            scale=inputs["scale"],
            grid=GRID,
            ray_rule="maximum",
        ).silhouette
        weight = jnp.cos(jnp.arange(silhouette.size)).reshape(silhouette.shape)
        return jnp.sum(silhouette * weight)

    with jax.enable_x64(True):
        inputs = {k: jnp.asarray(v) for k, v in make_inputs().items()}
        gradient = np.asarray(jax.grad(measure_maximum)(inputs)[name])
        away = rng.normal(size=gradient.shape)
        sides = [
            float(measure_maximum(inputs | {name: inputs[name] + s * 1e-7 * away}))
            for s in (1, -1)
        ]
    numeric = (sides[0] - sides[1]) / 2e-7
    assert np.sum(gradient * away) == pytest.approx(numeric, rel=1e-5, abs=1e-5)


def test_the_maximum_along_a_ray_is_that_of_its_occupancies():
    inputs = make_inputs()
    shared = {"sigma": 1.1, "scale": inputs["scale"], "grid": GRID}
    points = jnp.asarray(inputs["points"], "f4")
    image = dpc_jax.project(points, inputs["rotation"], ray_rule="maximum", **shared)
    occupancy = dpc_jax.voxelize(points, inputs["rotation"], **shared)
    np.testing.assert_array_equal(image.silhouette, np.max(occupancy, axis=-1))


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
def test_a_volume_and_its_terminations_give_the_silhouette(method):
    inputs = make_inputs()
    shared = {"sigma": 1.1, "scale": inputs["scale"], "grid": GRID, "method": method}
    points = jnp.asarray(inputs["points"], "f4")
    occupancy = dpc_jax.voxelize(points, inputs["rotation"], **shared)
    assert occupancy.shape == GRID.shape
    ends, background = dpc_jax.termination_probabilities(occupancy)
    silhouette = dpc_jax.project(points, inputs["rotation"], **shared).silhouette
    # Rounding of a sum and a product over nine cells.
    np.testing.assert_allclose(ends.sum(-1), silhouette, atol=1e-6)
    np.testing.assert_allclose(1 - background, silhouette, atol=1e-6)


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
@pytest.mark.parametrize("channels", [1, 3, 7])
def test_colours_of_any_number_of_channels_come_one_by_one(method, channels):
    inputs = make_inputs()
    colors = np.random.default_rng(4).uniform(size=(COUNT, channels)).astype("f4")

    @jax.jit
    def render(colors):
        return dpc_jax.project(
            jnp.asarray(inputs["points"], "f4"),
            inputs["rotation"],
            sigma=1.1,
            scale=inputs["scale"],
            colors=colors,
            grid=GRID,
            signals=("color",),
            method=method,
        ).color

    image = render(colors)
    assert image.shape == (10, 12, channels)
    for i in range(0, channels, 3):
        np.testing.assert_allclose(
            image[..., i], render(colors[:, i : i + 1])[..., 0], atol=1e-6
        )
