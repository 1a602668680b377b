"""Pictures of clouds as spheres, grids of pictures."""

import types

import numpy as np
import pytest
from PIL import Image

from dpc_jax.reporting.clouds import draw_cloud, shade_depth, view_points
from dpc_jax.reporting.gallery import draw_difference, draw_grid

FRONT = (0.0, 0.0)
RED, BLUE = [1.0, 0, 0], [0, 0, 1.0]


@pytest.mark.parametrize(
    ("view", "nearest"), [((0, 0), 0), ((90, 0), 1), ((123, 90), 2), ((180, 0), 3)]
)
def test_a_viewer_sees_the_side_its_angles_name(view, nearest):
    corners = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]], float)
    assert np.argmax(view_points(corners, view)[:, 2]) == nearest


def test_a_sphere_is_a_disc_of_its_size_at_its_place():
    picture = draw_cloud([[0, 0.25, 0.25]], [RED], view_deg=FRONT, radius=0.1, size=108)
    rows, cols = np.nonzero((picture < 250).any(-1))
    # The picture spans 1.08: 100 pixels an object unit. Seen from the front, +y is at
    # the right, z is up.
    assert abs(cols.mean() - (54 + 25)) < 1 and abs(rows.mean() - (54 - 25)) < 1
    assert len(rows) == pytest.approx(np.pi * 10**2, rel=0.1)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_the_nearer_of_two_spheres_hides_the_other(order):
    points, colors = np.array([[0.3, 0, 0], [-0.3, 0, 0]]), np.array([RED, BLUE])
    picture = draw_cloud(
        points[order], colors[order], view_deg=FRONT, radius=[0.1, 0.1], size=64
    )
    red, _, blue = picture[32, 32].astype(int)
    assert red > blue + 50


def test_far_points_are_paler_and_what_lies_outside_is_cut_off():
    near, far = shade_depth([[0.4, 0, 0], [-0.4, 0, 0]], FRONT)
    assert (near < far).all()
    empty = draw_cloud([[0, 5.0, 0]], [RED], view_deg=FRONT, size=32)
    assert (empty == 255).all()


def test_a_grid_has_its_pictures_in_reading_order_and_leaves_holes_empty(tmp_path):
    red, blue = (np.tile(np.uint8(255 * np.array(c)), (8, 8, 1)) for c in (RED, BLUE))
    path = draw_grid([[red, blue], [blue, None]], tmp_path / "a.png")
    picture = np.array(Image.open(path).convert("RGB")).astype(int)
    height, width = (side // 4 for side in picture.shape[:2])
    middles = [[picture[i * height, j * width] for j in (1, 3)] for i in (1, 3)]
    assert [np.argmax(c) for c in (*middles[0], middles[1][0])] == [0, 2, 2]
    assert middles[1][1].min() > 250


def test_the_difference_is_red_where_the_prediction_is_too_large():
    shown = types.SimpleNamespace(target=np.zeros((2, 2)), predicted=np.zeros((4, 4)))
    shown.predicted[0, 0], shown.target[1, 1] = 1.0, 1.0
    red, _, blue = np.moveaxis(255 * draw_difference(shown), -1, 0)
    assert red.shape == (4, 4) and red[0, 0] > blue[0, 0] + 50
    assert np.all(blue[2:, 2:] > red[2:, 2:] + 50) and np.all(red[:2, 2:] > 200)
