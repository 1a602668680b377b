"""`project_volume`: cells of the object frame against equations and known cases."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dpc_jax
from dpc_jax.measure.stability import oracles

ALL = ("silhouette", "depth", "color", "termination")
IDENTITY = jnp.array([1.0, 0.0, 0.0, 0.0])


def make_scene(seed=0, shape=(5, 7, 6), dtype=np.float64):
    rng = np.random.default_rng(seed)
    scene = {
        "volume": rng.uniform(0, 0.9, shape),
        "rotation": rng.normal(size=4),
        "colors": rng.uniform(size=(*shape, 2)),
        "translation": np.array([0.03, -0.05, 0.02]),
    }
    return {name: value.astype(dtype) for name, value in scene.items()}


@functools.partial(jax.jit, static_argnames="kind")
def render_all(scene, kind):
    return dpc_jax.project_volume(
        **scene,
        camera=dpc_jax.Camera(1.7, 2.1, kind),
        grid=dpc_jax.VoxelGrid((6, 8, 7), extent=1.1),
        signals=ALL,
        background_depth=5.0,
        background_color=0.25,
    )


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_images_equal_the_written_equations_in_float64(kind):
    scene = make_scene()
    with jax.enable_x64(True):
        image = render_all(scene, kind)
    names = ("volume", "colors", "rotation", "translation")
    expected = oracles.project_volume(
        *(*(scene[name] for name in names), 1.7, 2.1, 5.0, 0.25),
        shape=(6, 8, 7),
        extent=1.1,
        orthographic=kind == "orthographic",
    )
    assert expected[0].max() > 0.1
    for name, right in zip(ALL, expected, strict=False):
        # float64 rounding of a few hundred cells
        np.testing.assert_allclose(image[name], right, rtol=0, atol=1e-12)
    ends = np.asarray(image.termination).sum(-1)
    np.testing.assert_allclose(ends, expected[0], rtol=0, atol=1e-12)


@functools.partial(jax.jit, static_argnames=("side", "rule", "kind"))
def draw(volume, rotation, *, side=16, rule="termination", kind="perspective"):
    return dpc_jax.project_volume(
        volume,
        rotation,
        camera=dpc_jax.Camera(1.875, 2.0, kind),
        grid=dpc_jax.VoxelGrid(side),
        ray_rule=rule,
    ).silhouette


def test_rays_through_a_constant_volume_have_the_closed_form_of_their_rule():
    """Maximum: the constant. Termination: 1 - (1 - o)^n after n cells."""
    constant = 0.1
    inside = np.s_[5:11, 5:11]  # pixels whose rays stay inside the cube
    volume = jnp.full((8, 8, 8), constant)
    maximum = draw(volume, IDENTITY, rule="maximum", kind="orthographic")
    np.testing.assert_allclose(maximum[inside], constant, rtol=1e-6)
    # 16 cells of half a voxel: the outermost sample lies a quarter of a voxel outside
    # of the last centre, where the tents have three quarters of the constant.
    union = draw(volume, IDENTITY, kind="orthographic")
    expected = 1 - (1 - constant) ** 14 * (1 - 0.75 * constant) ** 2
    np.testing.assert_allclose(union[inside], expected, rtol=1e-5)


def test_under_the_maximum_only_the_fullest_cells_of_a_ray_have_a_gradient():
    """Samples lie on the centres of cells, exactly: sides are powers of two."""

    def look(ray):
        volume = jnp.zeros((8, 8, 8)).at[4, 4].set(ray)
        image = draw(volume, IDENTITY, side=8, rule="maximum", kind="orthographic")
        return image[4, 4]

    measure = jax.jit(jax.value_and_grad(look))
    fuller, equal = (0.8, [1.0, 0.0]), (0.6, [0.5, 0.5])  # shared where none is fuller
    for first, slopes in (fuller, equal):
        ray = jnp.zeros(8).at[2].set(first).at[7].set(0.6)
        value, gradient = measure(ray)
        assert float(value) == pytest.approx(first, rel=1e-6)
        np.testing.assert_allclose(gradient[jnp.array([2, 7])], slopes, atol=1e-6)
        np.testing.assert_allclose(
            jnp.delete(gradient, jnp.array([2, 7])), 0, atol=1e-6
        )


@pytest.mark.parametrize("combine", [jax.vmap, lambda f: lambda x: jax.lax.map(f, x)])
def test_under_the_maximum_views_have_their_gradients_however_they_are_combined(
    combine,
):
    """XLA computes a ray's cells twice; that rounding differs may lose no gradient."""
    rng = np.random.default_rng(0)
    volume = jnp.asarray(rng.uniform(size=(8, 8, 8)), jnp.float32)
    rotations = jnp.asarray(rng.normal(size=(4, 4)), jnp.float32)

    def look(volume, rotation):
        return jnp.sum(draw(volume, rotation, side=8, rule="maximum") ** 2)

    one = jax.jit(jax.grad(look))
    wanted = sum(one(volume, rotation) for rotation in rotations)
    found = jax.jit(
        jax.grad(lambda v: jnp.sum(combine(lambda r: look(v, r))(rotations)))
    )(volume)
    np.testing.assert_allclose(found, wanted, atol=2e-5)  # float32 sums of 64 pixels


def test_a_ball_has_the_disc_that_perspective_gives_it():
    """Radius 1.875·r/√(d² - r²) in image widths, to the width of the rim's cells."""
    side, radius = 48, 0.25
    centers = (np.arange(side) + 0.5) / side - 0.5
    away = np.linalg.norm(np.stack(np.meshgrid(*[centers] * 3), -1), axis=-1)
    image = draw(jnp.asarray(away < radius, jnp.float32), IDENTITY, side=side)
    found = np.sqrt(float(jnp.sum(image)) / side**2 / np.pi)
    assert found == pytest.approx(1.875 * 0.25 / np.sqrt(4 - 0.0625), abs=0.5 / side)


@pytest.mark.parametrize("turn, axes", [("z", (1, 0, 2)), ("y", (2, 1, 0))])
def test_turning_the_camera_is_turning_the_volume(turn, axes):
    volume = jnp.asarray(make_scene(seed=5, shape=(6, 6, 6))["volume"], jnp.float32)
    quarter = Rotation.from_euler(turn, 90, degrees=True)
    rotation = jnp.asarray(quarter.as_quat(scalar_first=True), jnp.float32)
    # x goes to y for the turn about z: the turned volume at (x, y) is the volume at
    # (y, -x); about y, z goes to x.
    turned = jnp.transpose(volume, axes)
    turned = jnp.flip(turned, axis=0 if turn == "z" else 2)
    np.testing.assert_allclose(
        draw(volume, rotation), draw(turned, IDENTITY), atol=1e-5
    )


def test_a_cell_lies_where_a_point_of_its_centre_lies():
    """So cells and points can be compared, and taught by the same silhouettes."""
    rng = np.random.default_rng(2)
    rotation = jnp.asarray(rng.normal(size=4), jnp.float32)
    for cell in rng.integers(1, 15, size=(6, 3)):
        volume = jnp.zeros((16, 16, 16)).at[tuple(cell)].set(1.0)
        image = np.asarray(draw(volume, rotation, side=32))
        center = jnp.asarray([(cell + 0.5) / 16 - 0.5], jnp.float32)
        point = dpc_jax.project(
            center, rotation, sigma=0.5, grid=dpc_jax.VoxelGrid(32)
        ).silhouette
        places = np.stack(np.indices((32, 32)), axis=-1)
        middles = [
            np.tensordot(seen, places, 2) / seen.sum()
            for seen in (image, np.asarray(point))
        ]
        # The cell's image is symmetric but for perspective and sampling.
        np.testing.assert_allclose(*middles, atol=0.2)


@functools.partial(jax.jit, static_argnames="kind")
def differentiate_total(volume, rotation, translation, distance, kind="perspective"):
    def total(volume, rotation, translation, distance):
        image = dpc_jax.project_volume(
            volume,
            rotation,
            colors=jnp.ones((*volume.shape, 1)),
            translation=translation,
            camera=dpc_jax.Camera(1.875, distance, kind),
            grid=dpc_jax.VoxelGrid(6),
            signals=ALL,
        )
        return sum(jnp.sum(image[name] ** 2) for name in ALL), image

    differentiate = jax.value_and_grad(total, argnums=(0, 1, 2, 3), has_aux=True)
    (_, image), gradients = differentiate(volume, rotation, translation, distance)
    return image, gradients


def test_occupancies_far_beyond_one_leave_colours_their_gradient():
    """A colour is a mean by occupancy, so its slope falls as they grow: 1e-30 here."""
    rng = np.random.default_rng(4)
    volume = jnp.asarray(rng.uniform(0.5, 1, (3, 3, 3)), jnp.float32)
    colors = jnp.asarray(rng.uniform(size=(3, 3, 3, 1)), jnp.float32)

    def total(volume):
        image = dpc_jax.project_volume(
            volume,
            IDENTITY,
            colors=colors,
            camera=dpc_jax.Camera(2.5),  # the view lies inside the volume
            grid=dpc_jax.VoxelGrid(4),
            signals=("color",),
        )
        return jnp.sum(image.color)

    # Powers of two, so that the large and the usual case round alike; every sample is
    # above one in both.
    small, large = (jax.grad(total)(volume * 2.0**k) for k in (5, 100))
    assert float(jnp.max(jnp.abs(small))) > 0
    np.testing.assert_allclose(large * 2.0**95, small, rtol=1e-4, atol=1e-7)


def test_places_that_are_not_finite_count_as_outside():
    image, _ = differentiate_total(
        jnp.ones((4, 4, 4)), IDENTITY, jnp.array([jnp.nan, 0, 0]), 2.0
    )
    assert np.all(np.asarray(image.silhouette) == 0)


def test_a_cell_that_is_not_finite_spoils_the_rays_that_read_it_alone():
    spoiled = np.full((4, 4, 4), 0.3, np.float32)
    spoiled[0, 0, 0] = np.nan
    call = jax.jit(functools.partial(dpc_jax.project_volume, grid=dpc_jax.VoxelGrid(4)))
    image = np.asarray(call(spoiled, IDENTITY).silhouette)
    # Half of the columns and half of the rows lie nearer to other cells.
    assert np.isnan(image[0, 0]) and np.isfinite(image[2:]).all()
    assert np.isfinite(image[:, 2:]).all()


def test_more_cells_than_the_gradient_can_number_are_refused():
    shape = jax.ShapeDtypeStruct((1290, 1290, 1290), np.float32)
    call = functools.partial(dpc_jax.project_volume, grid=dpc_jax.VoxelGrid(1))
    with pytest.raises(ValueError, match=r"2³¹ cells.*\[1290, 1290, 1290\].*coarser"):
        jax.eval_shape(call, shape, IDENTITY)


def test_signals_that_are_not_asked_for_are_none_and_colours_cost_nothing():
    scene = make_scene(dtype=np.float32)
    call = functools.partial(dpc_jax.project_volume, grid=dpc_jax.VoxelGrid(6))
    image = call(scene["volume"], scene["rotation"], colors=scene["colors"])
    assert image.depth is None and image.color is None and image.termination is None
    with_colors, without = (
        str(jax.make_jaxpr(call)(scene["volume"], scene["rotation"], colors=colors))
        for colors in (scene["colors"], None)
    )
    assert with_colors.count(" gather") == without.count(" gather")


GOOD = {"volume": np.zeros((4, 5, 6), "f4"), "rotation": np.ones(4, "f4")}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"volume": np.zeros((2, 4, 5, 6), "f4")}, r"volume.*\[X, Y, Z\].*vmap"),
        ({"volume": np.zeros((4, 0, 6), "f4")}, r"at least one cell.*\[4, 0, 6\]"),
        ({"volume": np.zeros((4, 5, 6), int)}, "volume.*floating.*int"),
        ({"rotation": np.ones(3, "f4")}, r"rotation.*\[4\].*\[3, 3\].*\[3\]"),
        ({"translation": np.ones(2)}, r"translation.*\[3\].*\[2\]"),
        ({"signals": ("color",)}, r"'color' must have colors.*\[X, Y, Z, C\]"),
        (
            {"colors": np.ones((4, 5, 3), "f4")},
            r"colors.*\[4, 5, 6, C\].*one colour per cell",
        ),
        ({"colors": np.ones((4, 5, 6, 0), "f4")}, r"colors.*\[X, Y, Z, C\].*C >= 1"),
        ({"ray_rule": "sum"}, "ray_rule.*termination.*sum"),
        ({"grid": 4}, "grid.*VoxelGrid"),
    ],
)
def test_wrong_arguments_are_refused_in_a_sentence(change, words):
    with pytest.raises(ValueError, match=words):
        dpc_jax.project_volume(**(GOOD | change))
