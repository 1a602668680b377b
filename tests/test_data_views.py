"""Views and ground truth against closed forms."""

import dataclasses

import numpy as np
import pytest
import trimesh

from dpc_jax.data import DataSpec, load_or_render, rendering, viewpoints, views
from dpc_jax.data.arrays import VISIBLE_STEPS
from dpc_jax.evaluation.rotations import view_angles
from dpc_jax.shapes import procedural

FOCAL, DISTANCE = 1.875, 2.0
LIGHTS = views.Lights(
    np.array([[0.6, 0, 0.8], [0, -0.8, 0.6]]), np.array([0.4, 0.3]), 0.6
)


def turn_to(azimuth, elevation):
    return viewpoints.look_at_rotation(np.deg2rad(azimuth), np.deg2rad(elevation))


def render(mesh, rotation, *, image_size=64, lights=LIGHTS, **options):
    scene = views.build_scene(mesh)
    return views.render_view(
        scene, rotation, lights=lights, image_size=image_size, **options
    )


def cast_rays(image_size, supersample):
    """Sample directions [S, S, k * k, 3] with z = 1, in the camera frame."""
    count = image_size * supersample
    line = ((np.arange(count) + 0.5) / count - 0.5) / FOCAL
    v, u = np.meshgrid(line, line, indexing="ij")
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    rays = rays.reshape(image_size, supersample, image_size, supersample, 3)
    return rays.swapaxes(1, 2).reshape(image_size, image_size, supersample**2, 3)


def paint_box(half):
    """A box, and the colours [axis, is the positive side, 3] of its sides.

    The corners of every third face run the other way round.
    """
    box = trimesh.creation.box(extents=2 * half)
    paint = np.random.default_rng(0).integers(60, 256, (3, 2, 3))
    paint[2, 1, 0] = 255  # which the lights from above would make more than white
    axis = np.abs(box.face_normals).argmax(axis=1)
    is_positive = (box.face_normals.sum(axis=1) > 0).astype(int)
    faces = np.where(np.arange(12)[:, None] % 3, box.faces, box.faces[:, ::-1])
    colors = paint[axis, is_positive]
    return trimesh.Trimesh(
        box.vertices, faces, face_colors=colors, process=False
    ), paint


@pytest.mark.parametrize(
    "angles, shift",
    [((30, 25), (0, 0, 0)), ((200, -15), (0.05, 0.08, 0.1)), ((45, 80), (0, 0, 0))],
)
def test_a_turned_and_moved_box_has_the_image_mask_and_depth_of_the_formula(
    angles, shift
):
    half, size, k = np.array([0.3, 0.2, 0.1]), 48, 4
    rotation, (box, paint) = turn_to(*angles), paint_box(half)
    view = render(box, rotation, image_size=size, translation=shift)
    # slabs: a ray is inside between its last entry and its first exit
    rays = cast_rays(size, k) @ rotation
    eye = -np.add(shift, (0, 0, DISTANCE)) @ rotation
    first, second = (-half - eye) / rays, (half - eye) / rays
    entries = np.minimum(first, second)
    enter, leave = entries.max(axis=-1), np.maximum(first, second).min(axis=-1)
    hit = enter < leave
    # float32 rays decide otherwise only where two of these are within 1e-6 of each
    # other
    near = np.diff(np.sort(entries, axis=-1), axis=-1)[..., -1] < 1e-6
    clear = ~(near | (np.abs(enter - leave) < 1e-6)).any(axis=-1)
    assert clear.mean() > 0.99
    expected = np.rint(255.0 * hit.mean(axis=-1))
    np.testing.assert_array_equal(view.mask[clear], expected[clear])
    depth = np.where(hit, enter, 0).sum(-1) / np.maximum(hit.sum(-1), 1)
    # float32 at 2.3 has steps of 2.4e-7, and slanted faces multiply them by up to 10
    np.testing.assert_allclose(view.depth[clear], depth[clear], atol=5e-6)
    # Lambert's law on the side that a ray enters, whose normal is against the ray
    side = entries.argmax(axis=-1)
    along = np.take_along_axis(rays, side[..., None], axis=-1)[..., 0]
    facing = np.maximum(-np.sign(along) * LIGHTS.towards[:, side], 0)
    lit = LIGHTS.ambient + np.tensordot(LIGHTS.strength, facing, 1)
    seen = np.minimum(paint[side, (along < 0).astype(int)] * lit[..., None], 255)
    image = np.where(hit[..., None], seen, 255).mean(axis=-2)
    np.testing.assert_allclose(view.image[clear], image[clear], atol=0.51)  # rounded


def test_lights_are_one_to_three_and_come_from_all_sides():
    drawn = [views.draw_lights(np.random.default_rng(seed)) for seed in range(300)]
    counts = np.bincount([len(lights.strength) for lights in drawn], minlength=4)
    # binomial, n = 300, p = 1/3: 100 with a standard deviation of 8; five of them
    assert counts[0] == 0 and (np.abs(counts[1:] - 100) < 41).all()
    towards = np.concatenate([lights.towards for lights in drawn])
    quarter = 2 * (towards[:, 0] > 0) + (towards[:, 1] > 0)
    share = np.bincount(quarter, minlength=4) / len(quarter)
    # n about 600, p = 1/4: standard deviation 0.018; five of them
    assert (np.abs(share - 0.25) < 0.09).all()
    assert all(lights.ambient > 0 for lights in drawn)
    assert towards[:, 2].min() > 0.1  # and from above


def test_viewpoints_are_drawn_as_in_the_paper():
    """Azimuth uniform in 360 degrees, elevation in [-20, 40]."""
    spec = DataSpec("car", models=1, views=400, image_size=2)
    arrays = rendering.render_mesh(procedural.make_shape("car", 0), spec, 0)
    azimuth, elevation = view_angles(arrays["quaternions"])
    # Kolmogorov and Smirnov: 400 draws differ by 0.098 with a probability of 0.001
    for values, low, high in ((azimuth, 0, 360), (elevation, -20, 40)):
        level = (np.sort(values) - low) / (high - low)
        assert np.abs(level - (np.arange(400) + 0.5) / 400).max() < 0.098


def test_a_floor_that_reaches_behind_the_camera_fills_the_bottom_of_the_image():
    corners = [[-9, -9, -0.3], [9, -9, -0.3], [9, 9, -0.3], [-9, 9, -0.3]]
    floor = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    mask = render(floor, turn_to(0, 0), image_size=32).mask
    # its far edge, 11 from the camera, lies at v = 1.875 * 0.3 / 11 = 0.051
    rows = (np.arange(32) + 0.5) / 32 - 0.5
    assert (mask[rows > 0.051 + 1 / 32] == 255).all()
    assert (mask[rows < 0.051 - 1 / 32] == 0).all()


def test_an_object_outside_of_the_image_and_one_without_area():
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    mesh.apply_translation((0.0, 0.0, 1.5))
    view = render(mesh, turn_to(0, 0), image_size=32)
    assert (view.image == 255).all() and not view.mask.any() and not view.depth.any()
    line = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False
    )
    with pytest.raises(ValueError, match="area"):
        views.sample_surface(line, count=9)


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


def test_thinning_keeps_the_mean_of_each_voxel():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (5000, 3))
    thin = rendering._thin_points(points, voxel=0.1)
    means = {}
    for point in points:
        means.setdefault(tuple(np.floor(point / 0.1)), []).append(point)
    expected = [np.mean(means[key], axis=0) for key in sorted(means)]
    np.testing.assert_allclose(thin, expected, atol=1e-6)  # float32
    assert thin.dtype == np.float32
    shuffled = rendering._thin_points(rng.permutation(points), voxel=0.1)
    np.testing.assert_allclose(shuffled, thin, atol=1e-6)


@pytest.mark.parametrize("count", [500, 20_000])  # all are tested; most are not
def test_points_of_what_is_visible_are_as_many_as_asked_for_and_even(count):
    balls = [trimesh.creation.icosphere(4, radius=radius) for radius in (0.4, 0.2)]
    both = trimesh.util.concatenate(balls)
    spec = DataSpec("car", visible_points=count)
    found = rendering.sample_visible(both, views.build_scene(both), spec)
    assert found.dtype == np.uint16 and found.shape == (count, 3)
    points = found / VISIBLE_STEPS - 0.5
    # Between the steps and the chords of the triangles of a ball.
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.4, atol=2e-3)
    # Standard error of the mean of a coordinate: 0.4 / √3 / √count.
    assert np.abs(points.mean(axis=0)).max() < 4 * 0.4 / np.sqrt(3 * count)


def test_a_point_is_seen_if_a_ray_over_the_rim_reaches_it():
    """An open box: its floor is seen from above only, its underside from below."""
    box = trimesh.creation.box(extents=[0.4, 0.4, 0.4])
    lid = np.isclose(box.face_normals[:, 2], 1)
    box.update_faces(~lid)
    points = np.array([[0.0, 0, -0.2], [0.19, 0, -0.1], [0, 0.2, 0]])
    scene = views.build_scene(box)
    assert rendering._find_visible(points, scene, distance=2.0).all()


def test_a_set_keeps_the_cameras_that_its_views_were_rendered_with(tmp_path):
    plain = DataSpec("car", models=1, views=3, image_size=32, surface_points=100)
    own = dataclasses.replace(plain, offset=0.1, focal_spread=0.2)
    moved, still = (
        load_or_render(spec, cache_dir=tmp_path, processes=1) for spec in (own, plain)
    )
    assert len(list(tmp_path.iterdir())) == 2  # of other cameras, another key
    assert still.translations is None and still.focal_lengths is None
    translations = np.asarray(moved.translations)
    focal_lengths = np.asarray(moved.focal_lengths)
    assert translations.shape == (1, 3, 3) and focal_lengths.shape == (1, 3)
    assert 0 < np.abs(translations).max() <= 0.1
    assert len(np.unique(focal_lengths)) == 3
    assert (np.abs(focal_lengths / 1.875 - 1) <= 0.2).all()
    # The same object from the same sides.
    np.testing.assert_array_equal(moved.quaternions[0], still.quaternions[0])
    np.testing.assert_array_equal(moved.surfaces[0], still.surfaces[0])
    assert (np.asarray(moved.masks) != np.asarray(still.masks)).any()
