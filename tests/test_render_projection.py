"""`project` against the written equations, its gradients, invariants and refusals."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from scipy.spatial.transform import Rotation

import dpc_jax

ALL = ("silhouette", "depth", "color")


def make_scene(count=12, channels=2, seed=0, spread=0.3):
    rng = np.random.default_rng(seed)
    return {
        "points": rng.uniform(-spread, spread, (count, 3)),
        "rotation": rng.normal(size=4),
        "colors": rng.uniform(size=(count, channels)),
        "scale": rng.uniform(0.5, 3.0, count),
        "translation": np.array([0.03, -0.05, 0.02]),
    }


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("sigma", [0.0, 0.7, 1.9])
def test_images_equal_the_written_equations_in_float64(kind, sigma):
    s = make_scene()
    with jax.enable_x64(True):
        image = dpc_jax.project(
            jnp.asarray(s["points"]),
            jnp.asarray(s["rotation"]),
            sigma=sigma,
            scale=s["scale"],
            colors=s["colors"],
            translation=s["translation"],
            camera=dpc_jax.Camera(1.7, 2.1, kind),
            grid=dpc_jax.VoxelGrid((9, 12, 7), extent=1.1),
            signals=ALL,
            background_depth=5.0,
            background_color=0.25,
        )
    expected = oracles.project(
        **s,
        sigma=sigma,
        shape=(9, 12, 7),
        focal_length=1.7,
        distance=2.1,
        extent=1.1,
        orthographic=kind == "orthographic",
        background_depth=5.0,
        background_color=0.25,
    )
    for name in ALL:  # float64 rounding of sums over a few hundred cells
        np.testing.assert_allclose(image[name], expected[name], rtol=0, atol=1e-12)


def test_float32_images_differ_from_float64_by_rounding_only():
    s = make_scene(count=40)
    image = render32(s["points"], s["rotation"], s["scale"], s["colors"])
    expected = oracles.project(
        s["points"],
        s["rotation"],
        sigma=1.2,
        scale=s["scale"],
        shape=(12, 12, 12),
        colors=s["colors"],
    )
    # A coordinate of 12 cells has an ulp of 1e-6 cells; depth is of order 10.
    for name, scale in (("silhouette", 1), ("depth", 10), ("color", 1)):
        np.testing.assert_allclose(image[name], expected[name], atol=2e-5 * scale)


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
    return _render32(*(jnp.asarray(a, jnp.float32) for a in (points, rotation, scale, colors)))


INPUTS = {
    "points": lambda s: s["points"],
    "rotation": lambda s: s["rotation"],
    "sigma": lambda s: np.array(1.1),
    "scale": lambda s: s["scale"],
    "colors": lambda s: s["colors"],
    "translation": lambda s: s["translation"],
    "focal_length": lambda s: np.array(1.8),
    "distance": lambda s: np.array(2.05),
    "background_depth": lambda s: np.array(4.0),
    "background_color": lambda s: np.array(0.5),
}


def weigh_images(weights, inputs):
    """A number that depends on every pixel of every signal."""
    inputs = dict(inputs)
    camera = dpc_jax.Camera(inputs.pop("focal_length"), inputs.pop("distance"))
    image = dpc_jax.project(
        inputs.pop("points"),
        inputs.pop("rotation"),
        camera=camera,
        grid=dpc_jax.VoxelGrid((7, 8, 6)),
        signals=ALL,
        **inputs,
    )
    return sum(jnp.sum(image[n] * w) for n, w in weights.items())


@functools.cache
def differentiate():
    return jax.jit(jax.value_and_grad(weigh_images, argnums=1))


@pytest.mark.parametrize("name", INPUTS)
def test_every_float_input_has_the_gradient_of_finite_differences(name):
    scene = make_scene(count=6, seed=3, spread=0.2)
    rng = np.random.default_rng(1)
    weights = {
        "silhouette": rng.normal(size=(7, 8)),
        "depth": rng.normal(size=(7, 8)),
        "color": rng.normal(size=(7, 8, 2)),
    }
    inputs = {key: np.asarray(make(scene)) for key, make in INPUTS.items()}
    direction = rng.normal(size=inputs[name].shape)
    # Central differences: error step², and rounding 1e-16/step; no point is within
    # 1e-5 cells of a kink (the agreement shows it).
    step = 1e-6
    with jax.enable_x64(True):
        _, gradient = differentiate()(weights, inputs)
        ends = [
            differentiate()(weights, inputs | {name: inputs[name] + sign * step * direction})
            for sign in (1, -1)
        ]
        slope = float(ends[0][0] - ends[1][0]) / (2 * step)
        along = float(np.sum(np.asarray(gradient[name]) * direction))
    assert along != 0
    assert along == pytest.approx(slope, rel=1e-6, abs=1e-8)


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


def test_the_order_of_the_points_does_not_matter():
    s = make_scene()
    order = np.random.default_rng(0).permutation(len(s["points"]))
    image = render32(s["points"], s["rotation"], s["scale"], s["colors"])
    same = render32(
        s["points"][order], s["rotation"], s["scale"][order], s["colors"][order]
    )
    np.testing.assert_allclose(same["color"], image["color"], atol=1e-5)


def test_more_mass_never_makes_a_silhouette_fainter():
    s = make_scene()
    images = [
        render32(s["points"], s["rotation"], k * s["scale"], s["colors"])["silhouette"]
        for k in (0.0, 0.5, 1.0, 4.0)
    ]
    assert np.all(np.asarray(images[0]) == 0)
    for fainter, fuller in zip(images, images[1:], strict=False):
        assert np.all(np.asarray(fuller) >= np.asarray(fainter))
        assert np.max(fuller) <= 1


def test_vmap_map_and_a_loop_agree():
    points = jnp.asarray(np.random.default_rng(0).uniform(-0.3, 0.3, (3, 10, 3)), "f4")
    poses = jnp.asarray(np.random.default_rng(1).normal(size=(3, 4)), "f4")

    def render(arguments):
        grid = dpc_jax.VoxelGrid(10)
        return dpc_jax.project(*arguments, sigma=1.0, grid=grid).silhouette

    mapped = jax.lax.map(render, (points, poses))
    vmapped = jax.vmap(lambda p, q: render((p, q)))(points, poses)
    looped = jnp.stack([render(pair) for pair in zip(points, poses, strict=True)])
    np.testing.assert_allclose(vmapped, mapped, atol=1e-6)  # order of float32 sums
    np.testing.assert_allclose(looped, mapped, atol=1e-6)


def test_the_points_dtype_decides_and_a_silhouette_leaves_the_rest_out():
    image = dpc_jax.project(jnp.zeros((1, 3)), jnp.eye(3), sigma=1, grid=dpc_jax.VoxelGrid(4))
    assert image.silhouette.dtype == jnp.float32
    assert image.depth is None and image.color is None
    with jax.enable_x64(True):
        image = dpc_jax.project(
            jnp.zeros((1, 3), "f8"), jnp.eye(3), sigma=1, grid=dpc_jax.VoxelGrid(4)
        )
        assert image.silhouette.dtype == jnp.float64


def count_flops(signals, colors=None):
    function = functools.partial(
        dpc_jax.project, sigma=1.5, grid=dpc_jax.VoxelGrid(16), signals=signals
    )
    arguments = (jnp.zeros((20, 3)), jnp.zeros(4))
    lowered = jax.jit(lambda p, q: function(p, q, colors=colors)).lower(*arguments)
    text = lowered.as_text()
    return lowered.compile().cost_analysis()["flops"], text


def test_the_compiled_silhouette_holds_neither_probabilities_nor_colours():
    colors = jnp.ones((20, 3))
    silhouette, text = count_flops(("silhouette",), colors)
    assert "cumprod" not in text
    depth, depth_text = count_flops(("depth",), colors)
    assert "cumprod" in depth_text
    color, color_text = count_flops(("color",), colors)
    assert silhouette < depth < color
    # Each of the three channels is one more volume to splat.
    assert color_text.count("scatter") > depth_text.count("scatter")


@pytest.mark.parametrize("z", [-2.0, -2.0 - 1e-7, -2.0 + 1e-7, -5.0, 1e6])
def test_points_at_and_behind_the_camera_leave_no_trace_and_no_nan(z):
    def total(points):
        image = dpc_jax.project(
            points,
            jnp.array([1.0, 0, 0, 0]),
            sigma=1.0,
            colors=jnp.ones((2, 1)),
            grid=dpc_jax.VoxelGrid(8),
            signals=ALL,
        )
        return jnp.sum(image.silhouette), image

    points = jnp.array([[0.0, 0.0, z], [1e-3, 0.0, z]])
    (value, image), gradient = jax.value_and_grad(total, has_aux=True)(points)
    assert value == 0
    assert np.all(np.asarray(image.depth) == 10) and np.all(np.asarray(image.color) == 1)
    assert np.all(np.asarray(gradient) == 0)


GOOD = {"points": np.zeros((5, 3), "f4"), "rotation": np.ones(4, "f4"), "sigma": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": np.zeros((2, 5, 3), "f4")}, r"points.*\[2, 5, 3\].*vmap"),
        ({"points": np.zeros((5, 2), "f4")}, r"points.*\[N, 3\].*\[5, 2\]"),
        ({"points": np.zeros((5, 3), int)}, "points.*floating.*int"),
        ({"rotation": np.ones(3, "f4")}, r"rotation.*\[4\].*\[3, 3\].*\[3\]"),
        ({"sigma": np.ones(5)}, r"sigma.*one number.*\[5\]"),
        ({"sigma": None}, "sigma.*None"),
        ({"covariance": np.ones((5, 3, 3))}, "covariance.*not yet supported"),
        ({"scale": np.ones(4)}, r"scale.*\[5\].*\[4\]"),
        ({"translation": np.ones(2)}, r"translation.*\[3\].*\[2\]"),
        ({"signals": ("shadow",)}, "signals.*silhouette.*shadow"),
        ({"signals": "depth"}, "signals.*tuple.*depth"),
        ({"signals": ()}, r"signals.*\(\)"),
        ({"signals": ("color",)}, "colors.*None"),
        ({"colors": np.ones((4, 3))}, r"colors.*N = 5.*\[4, 3\]"),
        ({"method": "gaussian"}, "method.*gaussian.*not yet supported"),
    ],
)
def test_wrong_arguments_are_refused_in_a_sentence(change, words):
    arguments = GOOD | change
    with pytest.raises(ValueError, match=f"(?s){words}") as error:
        dpc_jax.project(arguments.pop("points"), arguments.pop("rotation"), **arguments)
    assert str(error.value).endswith(".")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: dpc_jax.Camera(projection="fisheye"), "fisheye"),
        (lambda: dpc_jax.VoxelGrid(0), "positive.*0"),
        (lambda: dpc_jax.VoxelGrid((4, 4)), r"\(4, 4\)"),
        (lambda: dpc_jax.VoxelGrid(8, extent=0.0), "extent.*0.0"),
    ],
)
def test_impossible_cameras_and_grids_are_refused_in_a_sentence(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_second_call_with_another_sigma_compiles_nothing():
    render = jax.jit(
        lambda p, q, s: dpc_jax.project(p, q, sigma=s, grid=dpc_jax.VoxelGrid(6)).silhouette
    )
    for sigma in (0.0, 0.5, 3.0):
        render(jnp.zeros((2, 3)), jnp.ones(4), sigma)
    assert render._cache_size() == 1


def test_a_peak_height_gives_the_mass_of_its_gaussian():
    # ∫ c·exp(-r²/2σ²) = c·(2π)^{3/2}·σ³, by a sum over a fine grid.
    x = np.arange(-40, 41) * 0.25
    line = np.sum(np.exp(-0.5 * (x / 1.3) ** 2)) * 0.25
    assert float(dpc_jax.mass_of_peak(0.2, 1.3)) == pytest.approx(0.2 * line**3, rel=1e-6)
