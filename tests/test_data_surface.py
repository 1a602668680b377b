"""Ground truth points: one per voxel, all of the surface or what is seen of it."""

import numpy as np
import pytest
import trimesh

from dpc_jax.data import DataSpec, load_or_render, rendering, views

SPEC = DataSpec("car", models=1, surface_points=100_000, surface_voxel=0.01)


def change(**changes):
    return DataSpec(**{**vars(SPEC), **changes})


def make_ball(radius=0.4):
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


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


def test_ground_truth_is_dense_even_and_on_the_surface():
    points = rendering.make_ground_truth(make_ball(), SPEC)[0]
    # an even cover: about area / voxel², some more because voxels are cut obliquely
    area = 4 * np.pi * 0.16 / 1e-4
    assert area < len(points) < 2 * area
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - 0.4).max() < 0.01
    again = rendering.make_ground_truth(make_ball(), SPEC)[0]
    np.testing.assert_array_equal(points, again)
    assert np.linalg.norm(points.mean(axis=0)) < 0.01


@pytest.mark.parametrize("voxel", [0.0, 0.03])
def test_points_that_are_seen_are_marked_and_all_stay(voxel):
    both = trimesh.util.concatenate([make_ball(), make_ball(0.2)])
    spec = change(surface_seen=True, surface_voxel=voxel)
    points, seen = rendering.make_ground_truth(both, spec)
    assert seen is not None and seen.shape == points.shape[:1] and seen.dtype == bool
    np.testing.assert_array_equal(seen, np.linalg.norm(points, axis=1) > 0.3)
    plain, none = rendering.make_ground_truth(both, change(surface_voxel=voxel))
    assert none is None
    np.testing.assert_array_equal(points, plain)


def test_a_point_is_seen_if_a_ray_over_the_rim_reaches_it():
    """An open box: its floor is seen from above only, its underside from below."""
    box = trimesh.creation.box(extents=[0.4, 0.4, 0.4])
    lid = np.isclose(box.face_normals[:, 2], 1)
    box.update_faces(~lid)
    points = np.array([[0.0, 0, -0.2], [0.19, 0, -0.1], [0, 0.2, 0]])
    scene = views.build_scene(box)
    assert rendering._find_visible(points, scene, distance=2.0).all()
    closed = trimesh.creation.box(extents=[0.4, 0.4, 0.4])
    hidden = np.array([[0.0, 0, 0.05], [0.1, 0.1, 0.1]])
    assert not rendering._find_visible(
        hidden, views.build_scene(closed), distance=2.0
    ).any()


def test_models_keep_their_own_numbers_of_points(tmp_path):
    options = dict(models=3, views=1, image_size=16, surface_points=20_000)
    spec = DataSpec("chair", surface_voxel=0.02, **options)
    data = load_or_render(spec, cache_dir=tmp_path, processes=1, progress=False)
    sizes = [len(points) for points in data.surfaces]
    assert len(set(sizes)) > 1
    assert data.surfaces[0].shape == (sizes[0], 3)
    assert np.isfinite(data.surfaces[2]).all()
    with pytest.raises(ValueError, match="one by one"):
        np.asarray(data.surfaces)
