"""`project` and `project_volume` against the written equations, and what they return.

In float64, where tests/test_stability.py has the extremes and gradients in float32.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.exact import covariances

ALL = ("silhouette", "depth", "color", "termination")
SHAPE, EXTENT = (9, 12, 7), 1.1
FOCAL_LENGTH, DISTANCE, BEHIND = 1.7, 2.1, (5.0, 0.25)
COUNT, CELLS = 12, (5, 7, 6)
RNG = np.random.default_rng(0)
POSE, SHIFT = RNG.normal(size=4), np.array([0.03, -0.05, 0.02])
POINTS, MASSES = RNG.uniform(-0.3, 0.3, (COUNT, 3)), RNG.uniform(0.5, 3.0, COUNT)
SIZES = np.resize([0.0, 0.1, 0.5, 1.0, 3.0], COUNT)
COLORS, CELL_COLORS = RNG.uniform(size=(COUNT, 2)), RNG.uniform(size=(*CELLS, 2))
VOLUME = RNG.uniform(0, 0.9, CELLS)


@functools.partial(jax.jit, static_argnames=("function", "kind", "method"))
def render(function, first, rotation, kind, **inputs):
    return function(
        first,
        rotation,
        translation=SHIFT,
        camera=dpc_jax.Camera(FOCAL_LENGTH, DISTANCE, kind),
        grid=dpc_jax.VoxelGrid(SHAPE, extent=EXTENT),
        signals=ALL,
        background_depth=BEHIND[0],
        background_color=BEHIND[1],
        **inputs,
    )


def turn(kind):
    """A quaternion, or the same as a matrix."""
    is_matrix = kind == "orthographic"
    return oracles.rotate(np.eye(3), POSE).T.astype(float) if is_matrix else POSE


def assert_equal(image, expected):
    # float64 rounding of sums over a few hundred cells
    close = {"rtol": 0, "atol": 1e-12}
    assert expected[0].max() > 0.1
    for name, right in zip(ALL, expected, strict=False):
        np.testing.assert_allclose(image[name], right, **close)
    ends = np.asarray(image.termination)
    np.testing.assert_allclose(ends.sum(-1), expected[0], **close)
    np.testing.assert_allclose(image.background, 1 - expected[0], **close)
    depths = DISTANCE + ((np.arange(SHAPE[2]) + 0.5) / SHAPE[2] - 0.5) * EXTENT
    seen = ends @ depths + BEHIND[0] * (1 - expected[0])
    np.testing.assert_allclose(seen, expected[1], **close)


@pytest.mark.parametrize(
    "kind, method, sigma",
    [
        ("perspective", "trilinear", 0.0),
        ("orthographic", "trilinear", 0.7),
        ("perspective", "quadratic", 0.9),
        ("orthographic", "cubic", 1.1),
        ("perspective", "gaussian", SIZES),
    ],
)
def test_images_of_a_cloud_equal_the_written_equations(kind, method, sigma):
    own = {"sigma": sigma, "scale": MASSES, "colors": COLORS, "method": method}
    with jax.enable_x64(True):
        image = render(dpc_jax.project, POINTS, turn(kind), kind, **own)
    expected = oracles.project(
        *(POINTS, POSE, sigma, MASSES, COLORS, SHIFT, FOCAL_LENGTH, DISTANCE, *BEHIND),
        **{"shape": SHAPE, "extent": EXTENT, "orthographic": kind == "orthographic"},
        method=method,
    )
    assert_equal(image, expected)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_images_of_a_volume_equal_the_written_equations(kind):
    with jax.enable_x64(True):
        own = {"colors": CELL_COLORS}
        image = render(dpc_jax.project_volume, VOLUME, turn(kind), kind, **own)
    expected = oracles.project_volume(
        *(VOLUME, CELL_COLORS, POSE, SHIFT, FOCAL_LENGTH, DISTANCE, *BEHIND),
        **{"shape": SHAPE, "extent": EXTENT, "orthographic": kind == "orthographic"},
    )
    assert_equal(image, expected)


def test_a_well_sampled_covariance_gives_the_continuous_density():
    shape = (11, 20, 9)  # neither cubic nor a multiple of a tile's side
    rng = np.random.default_rng(0)
    coordinates = np.array(shape) * rng.uniform(-0.1, 1.1, (30, 3))
    values = rng.normal(size=(30, 2))
    half = rng.normal(size=(30, 3, 3)) * rng.uniform(0.3, 2, (30, 1, 1))
    matrices = half @ half.transpose(0, 2, 1) + 0.7 * np.eye(3)
    with jax.enable_x64(True):
        sum_points = functools.partial(covariances.sum_covariances, shape=shape)
        volume = jax.jit(sum_points)(coordinates, values, matrices)
    cells = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    expected = np.zeros((2, *shape))
    for point, value, matrix in zip(coordinates, values, matrices, strict=True):
        density = multivariate_normal(point, matrix).pdf(cells)
        expected += value[:, None, None, None] * density
    # Aliasing of the thinnest, 2·exp(-2π²·0.7) = 2e-6 of a density of at most 0.05.
    np.testing.assert_allclose(volume, expected, atol=3e-7)


def test_a_cloud_of_no_points_shows_the_background():
    scene = {"sigma": 1.2, "colors": np.zeros((0, 1)), "signals": ALL}
    scene |= {"rotation": np.eye(3), "grid": dpc_jax.VoxelGrid(4)}
    image = jax.jit(lambda points: dpc_jax.project(points, **scene))(jnp.zeros((0, 3)))
    np.testing.assert_array_equal(image.silhouette, np.zeros((4, 4)))
    np.testing.assert_array_equal(image.depth, np.full((4, 4), 10.0))
    np.testing.assert_array_equal(image.color, np.ones((4, 4, 1)))


@pytest.mark.parametrize(
    "dtype, other", [("float32", "float64"), ("float64", "float32")]
)
def test_the_dtype_of_the_points_decides_that_of_every_image(dtype, other):
    others = {"rotation": POSE, "sigma": SIZES, "scale": MASSES, "colors": COLORS}
    others |= {"translation": SHIFT, "camera": dpc_jax.Camera(FOCAL_LENGTH, DISTANCE)}
    project = functools.partial(dpc_jax.project, signals=ALL)
    with jax.enable_x64(True):
        others = jax.tree.map(lambda value: jnp.asarray(value, other), others)
        image = jax.eval_shape(project, POINTS.astype(dtype), **others)
    assert {image[name].dtype.name for name in ALL} == {dtype}


@pytest.mark.parametrize("signal", ALL)
def test_only_the_signal_asked_for_comes_back(signal):
    cells, pose = jnp.zeros((2, 2, 2)), jnp.eye(3)
    call = functools.partial(dpc_jax.project_volume, signals=(signal,))
    for image in (
        jax.eval_shape(lambda c: call(c, pose, colors=c[..., None]), cells),
        jax.eval_shape(
            lambda p: dpc_jax.project(p, pose, sigma=1, colors=p, signals=(signal,)),
            jnp.zeros((1, 3)),
        ),
    ):
        assert {name for name in ALL if image[name] is not None} == {signal}
