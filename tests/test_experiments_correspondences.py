"""Correspondences by point indices: what is selected, and what is said of it."""

import numpy as np
import pytest

from dpc_jax.data.views import sample_surface
from dpc_jax.experiments import correspondences
from dpc_jax.shapes.procedural import make_shape

KEYPOINTS = np.array([[0.4, 0.4, 0.4], [-0.4, -0.4, -0.4]])
FLAT = np.array([1.0, 1.0, 0.4])  # factors


def make_cloud(count=300):
    return np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))


def test_an_index_is_taken_only_where_it_is_near_in_every_template():
    first = make_cloud()
    second = first.copy()
    radius = 0.3
    near = np.flatnonzero(np.linalg.norm(first - KEYPOINTS[0], axis=1) <= radius)
    assert len(near) > 3
    second[near[1]] += 1.0  # strays in the second template alone
    found = correspondences.select_indices(
        [first, second], [KEYPOINTS, KEYPOINTS], radius=radius
    )
    assert found[0].tolist() == [near[0], *near[2:]]


def test_a_keypoint_without_enough_points_near_it_gets_the_nearest_ones():
    cloud = make_cloud()
    found = correspondences.select_indices([cloud], [KEYPOINTS], radius=1e-6, least=4)
    away = np.linalg.norm(cloud - KEYPOINTS[1], axis=1)
    assert sorted(found[1]) == sorted(np.argsort(away)[:4])


def test_indices_follow_a_shape_that_is_stretched_and_places_do_not():
    cloud = make_cloud(count=3000)
    template, marks = FLAT * cloud, FLAT * KEYPOINTS
    found = correspondences.select_indices([template], [marks], radius=0.1)
    stay = correspondences.select_nearest(cloud, marks, [len(i) for i in found])
    start = [template[index].mean(axis=0) for index in found]
    for indices, expected in ((found, 1.0), (stay, 0.0)):
        moves = np.array([cloud[index].mean(axis=0) for index in indices]) - start
        follows = correspondences.measure_following(moves, KEYPOINTS - marks)
        # The centre of some dozen points within 0.1 is not quite at the keypoint.
        assert follows == pytest.approx(expected, abs=0.15)


def test_points_have_the_labels_of_the_part_that_they_lie_on():
    mesh = make_shape("chair", 4)
    points, faces = sample_surface(mesh, count=300, seed=1)
    found = correspondences.label_points(points, 4)
    # Where parts touch, a point may be nearer to the other.
    assert np.mean(found == correspondences.label_faces(4)[faces]) > 0.95


def test_keypoints_are_on_their_part_and_left_and_right_are_alike():
    tips = []
    for seed in range(40):
        mesh, found = make_shape("chair", seed), correspondences.find_keypoints(seed)
        labels, heights = correspondences.label_faces(seed), []
        for name, position in found.items():
            label, _ = correspondences.KEYPOINTS[name]
            corners = mesh.vertices[mesh.faces[labels == label]].reshape(-1, 3)
            assert np.abs(corners - position).sum(-1).min() == 0, name
            if "left" in name:
                other = found[name.replace("left", "right")]
                # Seats and legs are symmetric, yet a star may move the box's middle.
                np.testing.assert_allclose(position[[0, 2]], other[[0, 2]], atol=1e-12)
                assert position[1] > other[1] + 0.1
            if "front" in name:
                assert position[0] > found[name.replace("front", "rear")][0]
            if label == "leg":
                heights.append(position[2] - mesh.bounds[0, 2])
        # The tubes of a sled reach half their width below their ends' rims.
        assert all(height < 0.04 for height in heights)
        tips.append(len(heights))
    assert set(tips) == {0, 4}
