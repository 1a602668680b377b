"""What wrong poses are: against poses made by angles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.evaluation.failures import KINDS, find_failures


def look(azimuth, elevation):
    return matrix_to_quaternion(look_at_rotation(*np.deg2rad([azimuth, elevation])))


def shake(quaternions, degrees, seed=0):
    """Rotations near these, by that angle about random axes."""
    axes = np.random.default_rng(seed).normal(size=(len(quaternions), 3))
    axes *= np.deg2rad(degrees) / np.linalg.norm(axes, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(axes) * Rotation.from_quat(
        quaternions, scalar_first=True
    )
    return turned.as_quat(scalar_first=True)


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
    poses = Rotation.from_quat(TRUE[:, 0], scalar_first=True) * about_front
    assert find_kinds(poses.as_quat(scalar_first=True)) == ["other half turn"] * 5


def test_shares_are_of_wrong_views_and_lost_objects_of_all():
    true = np.stack([TRUE[:, 0]] * 3)  # three objects of five views
    predicted = true.copy()
    for view in range(5):
        predicted[0, view] = look(ANGLES[view][0] + 180, ANGLES[view][1])
    predicted[1, 2] = look(180 - 140, -35)
    costs = np.zeros((3, 5, 2))
    costs[..., 1] = 1.0
    costs[0, :2, 1] = -1.0  # the truth is cheaper in two
    costs[2, :, 1] = -1.0  # right views do not count
    found = find_failures(predicted, true, costs=costs)
    np.testing.assert_array_equal(found.wrong_objects, [0])
    assert found.metrics == pytest.approx(
        {
            "wrong_object_share": 1 / 3,
            "wrong_half_turn_share": 5 / 6,
            "wrong_mirror_share": 1 / 6,
            "truth_cheaper_share": 2 / 6,
        }
    )


def test_where_nothing_is_wrong_there_are_no_shares():
    found = find_failures(TRUE, -TRUE, costs=np.zeros((5, 1, 2)))
    assert found.metrics == {"wrong_object_share": 0.0} and (found.kinds == -1).all()


def test_objects_of_a_single_view_are_not_lost_in_all():
    wrong = np.stack([look(a + 180, e) for a, e in ANGLES])[:, None]
    assert find_failures(wrong, TRUE).metrics["wrong_object_share"] == 0.0


def test_poses_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="Expected predicted and true poses"):
        find_failures(TRUE[:, 0], TRUE[:, 0])
