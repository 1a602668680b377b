"""A volume stored as touched blocks: the images and gradients of the whole volume."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render.blocks import capacity

ALL = ("silhouette", "depth", "color")
# Relative to the largest entry: sums of some hundred terms in another order. Those of
# the gradient to sigma have both signs: up to 2e-5 is seen.
ROUNDING = {"float32": 5e-5, "float64": 1e-12}


def make_inputs(dtype, *, sigma, scale=2.0, count=400):
    """A flat ellipsoid's surface, with points on cell centres, faces and outside."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    points *= [0.25, 0.12, 0.1] / np.linalg.norm(points, axis=1, keepdims=True)
    points[:4] = [[0.3, 0.3, 0.3], [0.5, 0, 0], [2, 0, 0], [0, 0, -0.499]]
    points[4:8] = (np.floor(points[4:8] * 40) + 0.5) / 40
    inputs = {
        "points": points,
        "rotation": rng.normal(size=4),
        "sigma": sigma,
        "scale": scale,
        "colors": rng.uniform(size=(count, 3)),
        "translation": [0.01, -0.02, 0.03],
        "background_depth": 9.0,
        "background_color": 0.5,
    }
    return {name: jnp.asarray(value, dtype) for name, value in inputs.items()}


def count(inputs, grid, method="trilinear"):
    names = ("points", "rotation", "sigma", "translation")
    given = {name: inputs[name] for name in names}
    return dpc_jax.count_blocks(**given, grid=grid, method=method)


STATIC = ("max_blocks", "grid", "signals", "method", "ray_rule")


@functools.partial(jax.jit, static_argnames=STATIC)
def render_both_ways(inputs, **static):
    """Images, and the gradients of a weighted sum of them."""

    def sum_images(inputs):
        images = dpc_jax.project(**inputs, **static)
        weights = np.random.default_rng(1)
        terms = [
            jnp.vdot(image, jnp.asarray(weights.normal(size=image.shape)))
            for image in jax.tree.leaves(images)
        ]
        return sum(terms).astype(inputs["points"].dtype), images

    grads, images = jax.grad(sum_images, has_aux=True)(inputs)
    return images, grads


def assert_same(found, right, dtype):
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True):
        assert a.dtype == b.dtype == dtype
        atol = ROUNDING[dtype] * max(np.abs(b).max(), 1e-3)
        np.testing.assert_allclose(a, b, rtol=0, atol=atol)


# Grids, of the second of which no side divides into blocks, and room in them.
CUBE, UNEVEN = 40, (44, 37, 50)
ROOM = {CUBE: 87, UNEVEN: 147}  # of 125 and 210


@pytest.mark.parametrize(
    "shape, sigma, scale, signals, options",
    [
        (CUBE, 0.5, 2.0, ALL, {}),
        # Full cells; points that take away.
        (CUBE, 0.4, 500.0, ALL, {}),
        (CUBE, 0.8, -1.0, ALL, {}),
        (UNEVEN, 0.8, 2.0, ("depth",), {"method": "cubic"}),
        # For these the whole volume stays.
        (CUBE, 0.5, 2.0, ("termination",), {"ray_rule": "maximum"}),
    ],
)
def test_blocks_have_the_images_and_gradients_of_the_whole_volume(
    shape, sigma, scale, signals, options
):
    with jax.enable_x64(True):
        grid = dpc_jax.VoxelGrid(shape)
        inputs = make_inputs("float64", sigma=sigma, scale=max(scale, 0))
        needed = int(count(inputs, grid, options.get("method", "trilinear")))
        assert 0 < needed <= ROOM[shape]
        inputs["scale"] = jnp.float64(scale)
        static = {"grid": grid, "signals": signals} | options
        right = render_both_ways(inputs, **static)
        found = render_both_ways(inputs, max_blocks=ROOM[shape], **static)
        assert_same(found, right, "float64")


@pytest.mark.slow  # half a minute
def test_second_derivatives_are_those_of_the_whole_volume():
    inputs = make_inputs("float32", sigma=0.6, count=30)
    grid = dpc_jax.VoxelGrid(32)

    def find_slope(sigma, max_blocks):
        def sum_image(points):
            image = dpc_jax.project(
                points,
                inputs["rotation"],
                sigma=sigma,
                grid=grid,
                max_blocks=max_blocks,
            ).silhouette
            return jnp.sum(image**2)

        return jnp.sum(jax.grad(sum_image)(inputs["points"]) ** 2)

    found, right = (
        jax.jit(jax.grad(lambda s, m=m: find_slope(s, m)))(inputs["sigma"])
        for m in (60, None)
    )
    np.testing.assert_allclose(found, right, rtol=1e-4)


@pytest.mark.parametrize("sigma, size", [(0.8, 1.8), (1e30, 1.0)])
def test_a_cloud_that_does_not_fit_is_drawn_in_the_whole_volume(sigma, size):
    with jax.enable_x64(True):
        inputs, grid = make_inputs("float64", sigma=sigma), dpc_jax.VoxelGrid(CUBE)
        inputs["points"] *= size
        assert int(count(inputs, grid)) > ROOM[CUBE]
        static = {"grid": grid, "signals": ALL}
        right = render_both_ways(inputs, **static)
        found = render_both_ways(inputs, max_blocks=ROOM[CUBE], **static)
        assert_same(found, right, "float64")


def test_clouds_side_by_side_are_each_drawn_as_they_need():
    """One fits into its room and one does not."""
    inputs, grid = make_inputs("float32", sigma=0.5), dpc_jax.VoxelGrid(CUBE)
    clouds = jnp.stack([0.1 * inputs["points"], inputs["points"]])
    rooms = [int(count(inputs | {"points": cloud}, grid)) for cloud in clouds]
    assert rooms[0] <= 30 < rooms[1]

    def render(points, **room):
        given = inputs | {"points": points}
        return render_both_ways(given, grid=grid, signals=("silhouette",), **room)

    found = jax.vmap(lambda cloud: render(cloud, max_blocks=30))(clouds)
    assert_same(found, jax.vmap(render)(clouds), "float32")


def test_where_the_whole_volume_is_too_large_what_does_not_fit_is_not_a_number(
    monkeypatch,
):
    monkeypatch.setattr(capacity, "SMALL_UP_TO", 1)
    inputs, grid = make_inputs("float32", sigma=0.5), dpc_jax.VoxelGrid(CUBE)
    needed = int(count(inputs, grid))
    static = {"grid": grid, "signals": ("silhouette", "depth"), "max_blocks": needed}
    render = jax.jit(lambda inputs: dpc_jax.project(**inputs, **static))
    for size, is_right in ((1.0, True), (1.5, False)):
        for image in jax.tree.leaves(
            render(inputs | {"points": size * inputs["points"]})
        ):
            assert np.isfinite(image).all() == is_right
            assert np.isnan(image).all() != is_right


def test_known_numbers_of_a_large_grid_are_drawn_in_as_many_blocks_as_they_need(
    monkeypatch,
):
    """And none are counted in a trace, in a small grid, or where all are touched."""
    monkeypatch.setattr(capacity, "_COUNTED_FROM", 40**3)
    monkeypatch.setattr(capacity, "_MOST_SHARE", 0.5)
    inputs = make_inputs("float32", sigma=0.5)
    inputs["points"] *= 0.4
    rooms, choose = [], capacity.choose_room
    monkeypatch.setattr(
        capacity, "choose_room", lambda *a: rooms.append(choose(*a)) or rooms[-1]
    )

    def render(given, side=40):
        return dpc_jax.project(**given, grid=dpc_jax.VoxelGrid(side)).silhouette

    found, traced = render(inputs), jax.jit(render)(inputs)
    assert_same(found, traced, "float32")
    render(inputs, side=32)
    render(inputs | {"sigma": jnp.float32(3)})
    needed = int(count(inputs, dpc_jax.VoxelGrid(40)))
    assert needed <= rooms[0] <= 1.2 * needed and rooms[1:] == [None] * 3


@pytest.mark.parametrize("place", [np.nan, 3.0])
def test_points_that_are_not_there_leave_the_image_empty(place):
    with jax.enable_x64(True):
        inputs, grid = make_inputs("float64", sigma=0.5), dpc_jax.VoxelGrid(CUBE)
        inputs["points"] = jnp.full_like(inputs["points"], place)
        static = {"grid": grid, "signals": ALL}
        images, _ = render_both_ways(inputs, max_blocks=ROOM[CUBE], **static)
    np.testing.assert_array_equal(images.silhouette, 0)
    np.testing.assert_array_equal(images.depth, 9)


def test_the_blocks_of_a_batch_are_counted_as_its_method_fills_them(monkeypatch):
    """For the example that touches most; at a sigma too wide for cubic splines."""
    monkeypatch.setattr(capacity, "_COUNTED_FROM", 1)
    monkeypatch.setattr(capacity, "SMALL_UP_TO", 1)
    monkeypatch.setattr(capacity, "_MOST_SHARE", 0.9)
    inputs = make_inputs("float32", sigma=1.25)
    images = dpc_jax.project_batch(
        jnp.stack([0.2 * inputs["points"], inputs["points"]]),
        jnp.stack([inputs["rotation"]] * 2),
        sigma=inputs["sigma"],
        scale=inputs["scale"],
        grid=dpc_jax.VoxelGrid(64),
        method="cubic",
    )
    assert np.isfinite(images.silhouette).all()
