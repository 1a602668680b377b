"""Pose errors against scipy's rotations, kinds of wrong poses, shares of candidates."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.pose import (
    KINDS,
    collapse_warning,
    count_alive,
    find_failures,
    pose_summary,
    winner_share,
)
from dpc_jax.evaluation.rotations import rotation_angle_deg


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 179.999999, 180.0])
def test_the_angle_is_exact_at_both_ends(angle):
    half = np.radians(angle) / 2
    turn = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
    got = rotation_angle_deg(turn, [1.0, 0, 0, 0])
    # One rounding of cos and sin: 1e-16 rad absolute at 0 and at 180 degrees alike.
    # The arc cosine would be wrong by 1e-6 degrees here.
    assert got == pytest.approx(angle, abs=1e-12)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [1, 0, np.inf, 0]])
def test_a_quaternion_that_is_no_rotation_is_refused_not_scored(bad):
    with pytest.raises(ValueError, match=r"1 of 2 .*index \[1\]"):
        rotation_angle_deg([[1.0, 0, 0, 0], bad], [1.0, 0, 0, 0])


def test_shapes_that_are_no_rotations_or_of_another_number_are_refused():
    with pytest.raises(ValueError, match=r"4 components .* shape \(3, 3\)"):
        rotation_angle_deg(np.eye(3), np.eye(3))
    with pytest.raises(ValueError, match=r"broadcast.*\(3, 4\) and \(2, 4\)"):
        rotation_angle_deg(np.ones((3, 4)), np.ones((2, 4)))


def test_quaternions_of_any_sign_and_length_are_scipys_rotations_and_back():
    a = Rotation.random(200, random_state=1)
    for scale in (-1.0, 7e180, 3e-200):
        back = rotations.to_rotation(scale * wxyz(a))
        # Scaling rounds each component once.
        np.testing.assert_allclose(back.as_matrix(), a.as_matrix(), atol=1e-14)
        assert rotation_angle_deg(scale * wxyz(a), wxyz(a)).max() < 1e-11
    np.testing.assert_array_equal(
        rotations.canonical_sign([0.0, 0.0, -1.0, 0.0]), [0.0, 0.0, 1.0, 0.0]
    )


def test_the_summary_names_accuracy_median_flips_and_histogram():
    got = pose_summary(np.array([[1.0, 2.0, 12.0, 30.0], [30.001, 40.0, 150.0, 180.0]]))
    assert (got.accuracy, got.flip_share) == (0.5, 1 / 8)
    assert got.median_error_deg == pytest.approx(30.0005)
    assert got.counts.sum() == 8 and got.counts[:3].tolist() == [2, 0, 1]
    assert got.edges_deg[[0, 1, -1]].tolist() == [0.0, 5.0, 180.0]


@pytest.mark.parametrize("errors", [[], [np.nan], [181.0]])
def test_errors_that_are_no_angles_are_refused(errors):
    with pytest.raises(ValueError, match="between 0 and 180"):
        pose_summary(errors)


def test_winner_shares_count_the_views_each_candidate_wins():
    shares = winner_share(np.array([[0, 6], [2, 10]]), heads=4)  # 6 and 10: turned
    assert shares.tolist() == [0.25, 0.0, 0.75, 0.0]
    assert count_alive(shares) == 2


def test_a_collapsed_ensemble_is_named_and_a_live_one_is_not():
    assert collapse_warning([0.5, 0.5]) is None
    assert collapse_warning([0.95, 0.05]) is None
    assert "head 1 wins 96.0 %" in collapse_warning([0.04, 0.96])
    # One below the limit of dominance, but the twelve others live by name only.
    assert "1 of 13 win" in collapse_warning([0.94] + [0.005] * 12)
    assert collapse_warning([1.0]) is None  # one regressor has nothing to collapse


# What wrong poses are, against poses made by angles.


def look(azimuth, elevation):
    return matrix_to_quaternion(look_at_rotation(*np.deg2rad([azimuth, elevation])))


def shake(quaternions, degrees):
    """Rotations near these, by that angle about random axes."""
    axes = np.random.default_rng(0).normal(size=(len(quaternions), 3))
    axes *= np.deg2rad(degrees) / np.linalg.norm(axes, axis=1, keepdims=True)
    return wxyz(Rotation.from_rotvec(axes) * rotations.to_rotation(quaternions))


ANGLES = [(20, 25), (75, 10), (140, 35), (250, -15), (310, 30)]
TRUE = np.stack([look(*angles) for angles in ANGLES])[:, None]


def find_kinds(poses, degrees=10):
    found = find_failures(shake(np.stack(poses), degrees)[:, None], TRUE)
    return [KINDS[k] if k >= 0 else "right" for k in found.kinds[:, 0]]


def test_views_are_sorted_by_the_pose_that_they_are_near_to():
    assert find_kinds(TRUE[:, 0], 25) == ["right"] * 5
    assert find_kinds([look(a + 180, e) for a, e in ANGLES]) == ["half turn"] * 5
    # The same silhouette: azimuth to 180° - azimuth, elevation to its negative.
    mirrored = find_kinds([look(180 - a, -e) for a, e in ANGLES])
    # Seen from nearly in front, the mirror pose of level views is near a half turn.
    assert set(mirrored) <= {"mirror pose", "half turn", "right"}
    assert mirrored[0] == mirrored[2] == mirrored[4] == "mirror pose"
    away = find_kinds([look(a + 90, e) for a, e in ANGLES])
    assert away[0] == away[2] == "other"


def test_a_half_turn_about_another_axis_is_told_from_one_about_up():
    about_front = Rotation.from_rotvec([np.pi, 0, 0])
    poses = wxyz(rotations.to_rotation(TRUE[:, 0]) * about_front)
    assert find_kinds(poses) == ["other half turn"] * 5


def test_shares_are_of_wrong_views_and_lost_objects_of_all():
    true = np.stack([TRUE[:, 0]] * 3)  # three objects of five views
    predicted = true.copy()
    for view in range(5):
        predicted[0, view] = look(ANGLES[view][0] + 180, ANGLES[view][1])
    predicted[1, 2] = look(180 - 140, -35)
    found = find_failures(predicted, true)
    away = np.abs(found.errors_deg - 180)  # half turns of upright cameras
    assert away[0].max() < 1e-5 and found.errors_deg[2].max() < 1e-5
    # The azimuths that the poses were made by.
    angles = np.array(ANGLES)[:, 0]
    np.testing.assert_allclose(found.azimuths_deg[0], angles, atol=1e-4)
    assert found.metrics == pytest.approx(
        {
            "wrong_object_share": 1 / 3,
            "wrong_half_turn_share": 5 / 6,
            "wrong_mirror_share": 1 / 6,
        }
    )


def test_right_poses_and_objects_of_a_single_view_are_not_lost():
    found = find_failures(TRUE, -TRUE)
    assert found.metrics == {"wrong_object_share": 0.0} and (found.kinds == -1).all()
    wrong = np.stack([look(a + 180, e) for a, e in ANGLES])[:, None]
    assert find_failures(wrong, TRUE).metrics["wrong_object_share"] == 0.0
