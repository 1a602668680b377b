"""Views: geometry of the camera, shading, borders, surface points."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dpc_jax.data import viewpoints, views
from dpc_jax.shapes import procedural

FOCAL, DISTANCE = 1.875, 2.0


def make_lights(towards=((0.0, 0.0, 1.0),), strength=(0.6,), ambient=0.3):
    return views.Lights(np.array(towards), np.array(strength), ambient)


def render(mesh, *, azimuth=0.0, elevation=0.0, image_size=32, lights=None, **options):
    rotation = viewpoints.look_at_rotation(azimuth, elevation)
    return views.render_view(
        mesh, rotation, lights=lights or make_lights(), image_size=image_size, **options
    )


def test_a_sphere_has_the_silhouette_and_the_depth_of_the_formula():
    radius, size = 0.3, 64
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    view = render(sphere, azimuth=0.7, elevation=0.3, image_size=size)
    # facets of 2 degrees lie at most r (1 - cos 1.2 deg) = 6e-5 inside of the sphere
    middle = view.depth[size // 2 - 1 : size // 2 + 1, size // 2 - 1 : size // 2 + 1]
    # the four central pixels reach 1/64 from the axis: 0.0083 off it at the surface,
    # where the sphere is up to 1.2e-4 deeper; compare with the mean over the samples
    u = ((np.arange(8) + 0.5) / (4 * size) - 1 / size) / FOCAL
    x, y = np.meshgrid(u, u)
    square = x**2 + y**2 + 1.0
    exact = (DISTANCE - np.sqrt(DISTANCE**2 - square * (DISTANCE**2 - radius**2))) / (
        square
    )
    assert abs(middle.mean() - exact.mean()) < 1e-4
    image_radius = FOCAL * radius / np.sqrt(DISTANCE**2 - radius**2) * size
    found = np.sqrt((view.mask / 255.0).sum() / np.pi)
    # 4x4 samples per pixel and 1000 pixels: the circle is counted to about 1 pixel of
    # area (Gauss's circle problem), that is 0.01 pixel of radius
    assert abs(found - image_radius) < 0.02


def test_a_box_covers_exactly_the_samples_that_the_formula_counts():
    half, size, k = 0.23, 32, 4
    box = trimesh.creation.box(extents=[2 * half] * 3)
    view = render(box, image_size=size, supersample=k)
    edge = FOCAL * half / (DISTANCE - half)
    samples = (np.arange(size * k) + 0.5) / (size * k) - 0.5
    line = (np.abs(samples) < edge).reshape(size, k).sum(axis=1)
    # the diagonal of the front face runs through samples: no hole may show there
    np.testing.assert_array_equal(
        view.mask, np.rint(np.outer(line, line) * 255.0 / k**2)
    )
    covered = view.mask > 0
    # float32 at 2.0: a few units in the last place of 2.4e-7
    np.testing.assert_allclose(view.depth[covered], DISTANCE - half, atol=2e-6)
    assert (view.depth[~covered] == 0).all()


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


@pytest.mark.parametrize(
    "axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 2, 3)]
)
@pytest.mark.parametrize("less", [0.0, 1e-7])
def test_half_turns_keep_their_digits_as_quaternions(axis, less):
    axis = np.array(axis) / np.linalg.norm(axis)
    rotation = Rotation.from_rotvec((np.pi - less) * axis)
    quaternion = viewpoints.matrix_to_quaternion(rotation.as_matrix())
    exact = rotation.as_quat(scalar_first=True)
    exact *= np.sign(exact @ quaternion)
    np.testing.assert_allclose(quaternion, exact, atol=1e-15 * 8)


def test_left_of_the_object_is_right_in_the_image_seen_from_the_front_and_up_is_up():
    def place(point):
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
        mesh.apply_translation(point)
        rows, cols = np.nonzero(render(mesh).mask)
        return rows.mean() - 15.5, cols.mean() - 15.5

    row, col = place((0.0, 0.3, 0.0))
    assert col > 5 and abs(row) < 0.5
    row, col = place((0.0, 0.0, 0.3))
    assert row < -5 and abs(col) < 0.5


def test_a_camera_at_a_pole_is_refused():
    with pytest.raises(ValueError, match="no upright direction"):
        viewpoints.look_at_rotation(0.0, np.pi / 2)


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


def test_an_open_shell_looks_the_same_whichever_way_its_corners_run():
    corners = [[0, -0.3, -0.3], [0, 0.3, -0.3], [0, 0.3, 0.3], [0, -0.3, 0.3]]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for azimuth in (0.0, np.pi):
        towards = (np.cos(azimuth), 0.0, 0.0)
        pictures = []
        for winding in (faces, faces[:, ::-1]):
            sheet = trimesh.Trimesh(corners, winding, process=False)
            lights = make_lights(towards=(towards,))
            pictures.append(render(sheet, azimuth=azimuth, lights=lights).image)
        np.testing.assert_array_equal(*pictures)
        behind = make_lights(towards=((-towards[0], 0.0, 0.0),))
        dark = render(sheet, azimuth=azimuth, lights=behind).image
        # ambient 0.3 against ambient and light 0.9
        assert dark[16, 16].sum() * 2.5 < pictures[0][16, 16].sum()


def test_shading_follows_lambert():
    sheet = trimesh.Trimesh(
        [[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3]],
        face_colors=[[200, 100, 50, 255]] * 2, process=False,
    )  # fmt: skip
    lights = make_lights(towards=((0.6, 0.8, 0.0),), strength=(0.5,), ambient=0.25)
    image = render(sheet, lights=lights).image
    expected = np.rint(np.array([200, 100, 50]) * (0.25 + 0.5 * 0.6))
    np.testing.assert_array_equal(image[16, 16], expected)


def test_the_image_is_blended_with_white_by_the_mask():
    box = trimesh.creation.box(extents=[0.46] * 3)
    box.visual.face_colors = [0, 0, 0, 255]
    view = render(box)
    partial = (view.mask > 0) & (view.mask < 255)
    assert partial.any()
    # both are rounded to integers: half a unit each
    blend = 255.0 - view.mask.astype(float)
    assert np.abs(view.image - blend[..., None]).max() <= 1.0


def test_the_same_view_is_rendered_to_the_same_bytes():
    mesh = procedural.make_shape("car", 1)
    scene = views.build_scene(mesh)
    for first, second in zip(render(mesh), render(scene), strict=True):
        np.testing.assert_array_equal(first, second)


def test_lights_shine_from_above_and_never_overexpose_by_much():
    for seed in range(20):
        lights = views.draw_lights(np.random.default_rng(seed))
        np.testing.assert_allclose(np.linalg.norm(lights.towards, axis=-1), 1.0)
        assert (lights.towards[:, 2] > 0).all()
        assert 0.3 < lights.ambient + lights.strength.sum() < 1.1


def test_surface_points_lie_on_the_surface_in_proportion_to_area():
    box = trimesh.creation.box(extents=[0.2, 0.4, 0.8])
    points = views.sample_surface(box, count=20_000, seed=3)
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
        points, views.sample_surface(box, count=20_000, seed=3)
    )
    assert (points != views.sample_surface(box, count=20_000, seed=4)).any()


def test_a_mesh_without_faces_or_area_is_refused():
    with pytest.raises(ValueError, match="faces"):
        views.build_scene(trimesh.Trimesh())
    line = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False
    )
    with pytest.raises(ValueError, match="area"):
        views.sample_surface(line)
    with pytest.raises(ValueError, match="at least 1"):
        render(trimesh.creation.box(), image_size=0)
