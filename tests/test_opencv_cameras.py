"""Cameras in pixels against K·(R·p + t) in numpy float64, there and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dpc_jax
from dpc_jax.render.camera import place_cells, to_camera_frame, to_grid
from dpc_jax.render.exact.covariances import move_covariance

WIDTH, HEIGHT = 96, 64
CENTER, RADIUS = np.array([3.0, -2.0, 0.5]), 1.5
# A list: jax 0.10 keeps an array that a float64 program has seen in float64.
SIZES = {"width": WIDTH, "height": HEIGHT, "center": [*CENTER], "radius": RADIUS}


def draw_camera(seed):
    """K with an off-centre principal point, and a camera that sees the object."""
    rng = np.random.default_rng(seed)
    focal = rng.uniform(70, 140, 2)
    place = rng.uniform(0.35, 0.65, 2) * [WIDTH, HEIGHT]
    lens = np.array([[focal[0], 0, place[0]], [0, focal[1], place[1]], [0, 0, 1]])
    turn = Rotation.random(random_state=seed).as_matrix()
    shift = rng.uniform([-0.3, -0.3, 6], [0.3, 0.3, 9]) - turn @ CENTER
    return lens, np.column_stack([turn, shift])


def find_pixels(lens, matrix, points):
    """Pixels [N, 2] and depths [N] of points of the object frame, in float64."""
    world = 2 * RADIUS * points + CENTER
    moved = world @ matrix[:, :3].T + matrix[:, 3]
    return (moved @ lens.T)[:, :2] / moved[:, 2:], moved[:, 2]


def test_points_are_at_the_pixels_that_k_says_and_depth_is_metric():
    lens, matrix = draw_camera(0)
    points = np.random.default_rng(0).uniform(-0.15, 0.15, (50, 3))
    view = dpc_jax.from_opencv(lens, matrix, **SIZES)
    assert view.grid.shape == (HEIGHT, WIDTH, WIDTH)
    pixels, depths = find_pixels(lens, matrix, points)
    placed = (jnp.asarray(a, "f4") for a in (points, view.rotation, view.translation))
    moved = to_camera_frame(*placed)
    cells, is_inside = to_grid(moved, camera=view.camera, grid=view.grid)
    assert np.all(is_inside)
    # A millionth of 96 pixels, float32.
    np.testing.assert_allclose(cells[:, 1::-1], pixels, atol=1e-4)
    metric = np.asarray(view.grid.depths(view.camera)) * 2 * RADIUS
    found = np.interp(np.asarray(cells[:, 2]), np.arange(WIDTH), metric)
    np.testing.assert_allclose(found, depths, rtol=1e-5)


@jax.jit
def find_centroid(lens, matrix, point):
    """Pixel (x, y) of a drawn point."""
    view = dpc_jax.from_opencv(lens, matrix, **SIZES, depth=8)
    image = dpc_jax.project(point, **view._asdict(), sigma=1.0).silhouette
    rows, cols = jnp.meshgrid(*map(jnp.arange, image.shape), indexing="ij")
    return jnp.stack([jnp.sum(image * cols), jnp.sum(image * rows)]) / jnp.sum(image)


def test_a_drawn_point_has_its_pixel_and_gradients_reach_the_numbers_of_k():
    lens, matrix = draw_camera(0)
    point = np.array([[0.11, -0.07, 0.13]])
    with jax.enable_x64(True):
        found = find_centroid(lens, matrix, point)
        (pixel,), _ = find_pixels(lens, matrix, point)
        # Trilinear weights keep the mean place of a point.
        np.testing.assert_allclose(found, pixel, atol=0.1)
        slopes = jax.jit(jax.jacrev(find_centroid))(lens, matrix, point)
        for row, col in ((0, 0), (1, 1), (0, 2), (1, 2)):
            step = 1e-4 * np.eye(3)[row][:, None] * np.eye(3)[col]
            ends = [find_centroid(lens + s * step, matrix, point) for s in (1, -1)]
            # Central differences, of steps within a cell: error of order step².
            expected = (ends[0] - ends[1]) / 2e-4
            np.testing.assert_allclose(slopes[:, row, col], expected, atol=1e-5)


def test_the_way_back_gives_the_same_camera():
    lens, matrix = draw_camera(3)
    view = dpc_jax.from_opencv(lens, matrix, **SIZES)
    back = dpc_jax.to_opencv(**view._asdict(), center=CENTER, radius=RADIUS)
    # float32 of numbers up to 140
    np.testing.assert_allclose(back[0], lens, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(back[1], matrix, rtol=1e-5, atol=1e-5)


def test_far_from_the_origin_no_digits_are_lost():
    lens, matrix = draw_camera(1)
    away = np.array([4e5, -3e5, 2e3])  # metres, as in a map
    moved = np.column_stack([matrix[:, :3], matrix[:, 3] - matrix[:, :3] @ away])
    near = dpc_jax.from_opencv(lens, matrix, **SIZES)
    far = dpc_jax.from_opencv(lens, moved, **SIZES | {"center": CENTER + away})
    for name in ("rotation", "translation"):
        found, expected = getattr(far, name), getattr(near, name)
        np.testing.assert_allclose(found, expected, atol=1e-9)  # float64, of 4e5


def test_cells_go_back_to_where_points_come_from():
    view = dpc_jax.from_opencv(*draw_camera(2), **SIZES, depth=5)
    places, ahead = place_cells(view.camera, view.grid)
    assert np.all(ahead)
    points = jnp.stack([place[10, 70] for place in places], axis=-1)
    moved = to_camera_frame(points, jnp.eye(3), None)
    found = to_grid(moved, camera=view.camera, grid=view.grid)[0]
    expected = [(10, 70, depth) for depth in range(5)]
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_gaussian_is_carried_by_the_derivative_of_the_camera():
    view = dpc_jax.from_opencv(*draw_camera(5), **SIZES)
    place = np.array([0.1, -0.05, 0.12])
    size = np.array([[2.0, 0.3, 0], [0.3, 1.0, 0.1], [0, 0.1, 0.5]])
    ahead = place + [0, 0, view.camera.distance]

    def find_cell(place):
        return to_grid(place[None], camera=view.camera, grid=view.grid)[0][0]

    with jax.enable_x64(True):
        slopes = np.asarray(jax.jacrev(find_cell)(jnp.asarray(place))) / HEIGHT
        how = {"camera": view.camera, "grid": view.grid}
        found = move_covariance(size[None], jnp.asarray(ahead)[None], jnp.eye(3), **how)
    np.testing.assert_allclose(found[0], slopes @ size @ slopes.T, rtol=1e-10)


LENS, MATRIX = draw_camera(0)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"K": LENS[:2]}, r"K must have shape \[3, 3\]"),
        ({"K": LENS + np.diag([1.0, 0], 1)}, "skew"),
        ({"K": -LENS}, "f_x, f_y above 0"),
        ({"K": LENS * np.nan}, "finite and f_x"),
        ({"world_to_camera": 2 * MATRIX}, "must be a rotation"),
        ({"world_to_camera": MATRIX * [[1], [1], [-1]]}, "invert camera-to-world"),
        ({"world_to_camera": MATRIX[:, :3]}, r"\[3, 4\] or \[4, 4\]"),
        ({"radius": 0.0}, "radius must be finite and above 0"),
        ({"center": [np.inf, 0, 0]}, "finite"),
        ({"width": 0}, "positive int"),
    ],
)
def test_what_no_camera_has_is_refused_in_a_sentence(changes, words):
    given = {"K": LENS, "world_to_camera": MATRIX} | SIZES | changes
    with pytest.raises(ValueError, match=words):
        dpc_jax.from_opencv(**given)
