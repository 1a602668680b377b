"""`project` against the written equations, and what leaves its images as they are."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dpc_jax
from dpc_jax.measure.stability import oracles

ALL = ("silhouette", "depth", "color", "termination")


def make_scene(count=12, channels=2, seed=0, spread=0.3):
    rng = np.random.default_rng(seed)
    return {
        "points": rng.uniform(-spread, spread, (count, 3)),
        "rotation": rng.normal(size=4),
        "colors": rng.uniform(size=(count, channels)),
        "scale": rng.uniform(0.5, 3.0, count),
        "translation": np.array([0.03, -0.05, 0.02]),
    }


@functools.partial(jax.jit, static_argnames="kind")
def render_all(scene, sigma, kind):
    return dpc_jax.project(
        **scene,
        sigma=sigma,
        camera=dpc_jax.Camera(1.7, 2.1, kind),
        grid=dpc_jax.VoxelGrid((9, 12, 7), extent=1.1),
        signals=ALL,
        background_depth=5.0,
        background_color=0.25,
    )


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("sigma", [0.0, 0.7, 1.9])
def test_images_equal_the_written_equations_in_float64(kind, sigma):
    s = make_scene()
    with jax.enable_x64(True):
        image = render_all(s, sigma, kind)
    expected = oracles.project(
        *(s["points"], s["rotation"], sigma, s["scale"], s["colors"]),
        *(s["translation"], 1.7, 2.1, 5.0, 0.25),
        shape=(9, 12, 7),
        extent=1.1,
        orthographic=kind == "orthographic",
    )
    # float64 rounding of sums over a few hundred cells
    close = {"rtol": 0, "atol": 1e-12}
    for name, right in zip(ALL, expected, strict=False):
        np.testing.assert_allclose(image[name], right, **close)
    shares = np.asarray(image.termination)
    np.testing.assert_allclose(shares.sum(-1), expected[0], **close)
    depths = 2.1 + ((np.arange(7) + 0.5) / 7 - 0.5) * 1.1
    seen = shares @ depths + 5.0 * (1 - expected[0])
    np.testing.assert_allclose(seen, expected[1], **close)


@jax.jit
def _render32(points, rotation, scale, colors):
    return dpc_jax.project(
        points,
        rotation,
        sigma=1.2,
        scale=scale,
        colors=colors,
        grid=dpc_jax.VoxelGrid(12),
        signals=ALL,
    )


def render32(points, rotation, scale, colors):
    return _render32(
        *(jnp.asarray(a, jnp.float32) for a in (points, rotation, scale, colors))
    )


def test_a_quaternion_its_negative_and_its_matrix_give_one_image():
    s = make_scene()
    matrix = Rotation.from_quat(s["rotation"], scalar_first=True).as_matrix()
    image = render32(s["points"], s["rotation"], s["scale"], s["colors"])
    for other in (-s["rotation"], 7 * s["rotation"], matrix):
        same = render32(s["points"], other, s["scale"], s["colors"])
        # A coordinate of 12 cells has an ulp of 1e-6 cells.
        np.testing.assert_allclose(same["silhouette"], image["silhouette"], atol=1e-5)


def test_a_quarter_turn_of_the_camera_turns_the_image():
    s = make_scene()
    image = render32(s["points"], np.eye(3), s["scale"], s["colors"])
    # x -> y, y -> -x: what was to the right is now below.
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = render32(s["points"], turn, s["scale"], s["colors"])
    for name in ALL:
        expected = np.rot90(image[name], -1)
        np.testing.assert_allclose(turned[name], expected, atol=1e-4)


def test_a_peak_height_gives_the_mass_of_its_gaussian():
    # ∫ c·exp(-r²/2σ²) = c·(2π)^{3/2}·σ³, by a sum over a fine grid.
    x = np.arange(-40, 41) * 0.25
    line = np.sum(np.exp(-0.5 * (x / 1.3) ** 2)) * 0.25
    assert float(dpc_jax.mass_of_peak(0.2, 1.3)) == pytest.approx(
        0.2 * line**3, rel=1e-6
    )


@pytest.mark.parametrize("count", [0, 1])
def test_a_cloud_of_no_or_one_point_has_its_images(count):
    image = render32(
        *(np.zeros((count, 3)), np.array([1.0, 0, 0, 0])),
        *(np.ones(count), np.ones((count, 1))),
    )
    assert image.silhouette.shape == image.depth.shape == (12, 12)
    assert image.color.shape == (12, 12, 1)
    assert (np.max(image.silhouette) > 0) == (count > 0)
    assert np.all(np.isfinite(image.depth))


@pytest.mark.parametrize("points_dtype", ["float32", "float64"])
@pytest.mark.parametrize("other_dtype", ["float32", "float64"])
def test_the_dtype_of_the_points_decides_that_of_every_image(points_dtype, other_dtype):
    @jax.jit
    def render(points, rotation, others):
        sigma, scale, translation, colors, focal_length, distance = others
        return dpc_jax.project(
            points,
            rotation,
            sigma=sigma,
            scale=scale,
            translation=translation,
            colors=colors,
            camera=dpc_jax.Camera(focal_length, distance),
            grid=dpc_jax.VoxelGrid(4),
            signals=("silhouette", "depth", "color"),
        )

    shapes = ((), (2,), (3,), (2, 1), (), ())
    with jax.enable_x64(True):
        image = jax.eval_shape(
            render,
            jax.ShapeDtypeStruct((2, 3), points_dtype),
            jax.ShapeDtypeStruct((4,), other_dtype),
            [jax.ShapeDtypeStruct(shape, other_dtype) for shape in shapes],
        )
    assert image.silhouette.dtype == points_dtype
    assert image.depth.dtype == points_dtype
    assert image.color.dtype == points_dtype


@pytest.mark.parametrize("signal", ["silhouette", "depth", "color"])
def test_only_the_signal_asked_for_comes_back(signal):
    image = jax.eval_shape(
        lambda points: dpc_jax.project(
            points, jnp.eye(3), sigma=1, colors=points, signals=(signal,)
        ),
        jnp.zeros((1, 3)),
    )
    given = {n for n in ("silhouette", "depth", "color") if image[n] is not None}
    assert given == {signal}
