"""Views: geometry of the camera, shading, borders, surface points."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dpc_jax.data import viewpoints, views


def make_lights(towards=((0.0, 0.0, 1.0),), strength=(0.6,), ambient=0.3):
    return views.Lights(np.array(towards), np.array(strength), ambient)


def render(mesh, *, azimuth=0.0, elevation=0.0, image_size=32, lights=None, **options):
    rotation = viewpoints.look_at_rotation(azimuth, elevation)
    return views.render_view(
        mesh, rotation, lights=lights or make_lights(), image_size=image_size, **options
    )


def test_rotations_are_those_of_scipy():
    start = np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]])  # camera on +x, z up
    for azimuth, elevation in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2)):
        turns = Rotation.from_euler("zy", [-4 * azimuth, elevation])
        expected = start @ turns.as_matrix()
        found = viewpoints.look_at_rotation(4 * azimuth, elevation)
        np.testing.assert_allclose(found, expected, atol=1e-15 * 8)  # rounding of cos
        quaternion = viewpoints.matrix_to_quaternion(found)
        exact = Rotation.from_matrix(expected).as_quat(scalar_first=True)
        assert abs(abs(quaternion @ exact) - 1) < 1e-14
        assert quaternion[0] >= 0


def test_an_object_around_or_behind_the_camera_is_rendered_without_a_crop():
    room = trimesh.creation.box(extents=[6.0, 6.0, 6.0])
    view = render(room, image_size=8)
    assert (view.mask == 255).all()
    # the wall behind the object, 3 beyond its centre; float32 at 5.0
    np.testing.assert_allclose(view.depth, 5.0, atol=3e-6)


def test_a_floor_that_reaches_behind_the_camera_fills_the_bottom_of_the_image():
    corners = [[-9, -9, -0.3], [9, -9, -0.3], [9, 9, -0.3], [-9, 9, -0.3]]
    floor = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    mask = render(floor).mask
    # its far edge, 11 from the camera, lies at v = 1.875 * 0.3 / 11 = 0.051
    rows = (np.arange(32) + 0.5) / 32 - 0.5
    assert (mask[rows > 0.051 + 1 / 32] == 255).all()
    assert (mask[rows < 0.051 - 1 / 32] == 0).all()


def test_an_object_outside_of_the_image_leaves_it_white():
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    mesh.apply_translation((0.0, 0.0, 1.5))
    view = render(mesh)
    assert (view.image == 255).all() and not view.mask.any() and not view.depth.any()


def test_surface_points_lie_on_the_surface_in_proportion_to_area():
    box = trimesh.creation.box(extents=[0.2, 0.4, 0.8])
    points, _ = views.sample_surface(box, count=20_000, seed=3)
    assert points.dtype == np.float32
    share = np.abs(points) / [0.1, 0.2, 0.4]
    assert np.abs(share.max(axis=1) - 1.0).max() < 1e-6  # float32
    side = np.bincount(share.argmax(axis=1), minlength=3) / len(points)
    area = np.array([0.32, 0.16, 0.08])
    # stratified by area: each triangle is off by at most one point, four per pair
    np.testing.assert_allclose(side, area / area.sum(), atol=4 / 20_000)
    # mean and second moment of a uniform square, to five standard errors
    big = share.argmax(axis=1) == 0
    z = points[big, 2] / 0.4
    assert abs(z.mean()) < 5 * 0.58 / np.sqrt(big.sum())
    assert abs((z**2).mean() - 1 / 3) < 5 * 0.3 / np.sqrt(big.sum())
    np.testing.assert_array_equal(
        points, views.sample_surface(box, count=20_000, seed=3)[0]
    )
    assert (points != views.sample_surface(box, count=20_000, seed=4)[0]).any()


def test_a_mesh_without_area_is_refused():
    line = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False
    )
    with pytest.raises(ValueError, match="area"):
        views.sample_surface(line, count=9)
