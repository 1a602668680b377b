"""The canonical alignment: known rotations come back, through flips and noise."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation import alignment as alignments
from dpc_jax.evaluation.alignment import align, find_modes

HALF_TURN_Z = Rotation.from_rotvec([0.0, 0.0, np.pi])
FRAMES = {
    "identity": Rotation.identity(),
    "half turn askew": Rotation.from_rotvec(np.pi * np.array([0.6, 0.0, 0.8])),
    "anything": Rotation.random(random_state=5),
}


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


def to_scipy(quaternions):
    return Rotation.from_quat(np.reshape(quaternions, (-1, 4)), scalar_first=True)


def gap_deg(quaternion, rotation):
    """Angle by scipy alone."""
    return np.degrees((to_scipy(quaternion) * rotation.inv()).magnitude()).item()


def wedge(rng, n):
    """Points of a solid without symmetry: a box, a cabin behind, a fin at a side."""
    box = rng.uniform(-0.5, 0.5, (n, 3)) * [0.9, 0.4, 0.2]
    cabin = rng.uniform(-0.5, 0.5, (n, 3)) * [0.4, 0.3, 0.2] + [-0.2, 0.0, 0.2]
    fin = rng.uniform(-0.5, 0.5, (n, 3)) * [0.1, 0.1, 0.1] + [0.3, 0.2, 0.1]
    kind = rng.choice(3, size=(n, 1), p=[0.6, 0.3, 0.1])
    return np.where(kind == 0, box, np.where(kind == 1, cabin, fin))


def scene(frame, *, flips=0.0, noise_deg=0.0, models=8):
    """What a network would predict whose frame is turned: object point = frame p."""
    rng, views = np.random.default_rng(0), 5
    count = models * views
    truth = Rotation.random(count, random_state=1)
    flipped = np.zeros(count)
    flipped[: round(flips * count)] = np.pi
    flip = Rotation.from_rotvec(rng.permutation(flipped)[:, None] * [0.0, 0.0, 1.0])
    noise = Rotation.from_rotvec(np.radians(noise_deg) * rng.normal(size=(count, 3)))
    predicted = wxyz(noise * truth * flip * frame)
    predicted *= rng.choice([-1.0, 1.0], size=(count, 1))  # q and -q are one rotation
    surfaces = np.stack([wedge(rng, 1500) for _ in range(models)])
    points = np.stack(
        [[frame.inv().apply(wedge(rng, 400)) for _ in range(views)] for _ in surfaces]
    )
    shape = (models, views, 4)
    return predicted.reshape(shape), wxyz(truth).reshape(shape), points, surfaces


@pytest.mark.parametrize("name", FRAMES)
def test_a_known_frame_is_recovered_in_spite_of_flips_and_noise(name):
    got = align(*scene(FRAMES[name], flips=0.3, noise_deg=4.0))
    # 28 agreeing views with 4 degrees per axis: their mean is good to 0.8 degrees per
    # axis, 1.3 in angle; ICP on sampled clouds does no worse. 2 leaves a margin.
    assert gap_deg(got.rotation, FRAMES[name]) < 2.0
    assert got.inlier_share == pytest.approx(0.7)


def vote(predicted, truth):
    return wxyz(to_scipy(truth).inv() * to_scipy(predicted))


def test_without_noise_the_vote_is_exact_even_at_half_turns():
    name = "half turn askew"
    predicted, truth, *_ = scene(FRAMES[name], flips=0.3)
    best = find_modes(vote(predicted, truth))[0]
    # The flipped 30 % weigh 5e-5 each and pull along the great circle of their own
    # half turn, where the mean is stationary: only rounding is left.
    assert gap_deg(best.rotation, FRAMES[name]) < 1e-4
    assert best.inlier_share == pytest.approx(0.7)


def test_without_shapes_the_poses_alone_vote():
    predicted, truth, *_ = scene(FRAMES["anything"], flips=0.2, noise_deg=2.0)
    got = align(predicted, truth, None, None)
    assert gap_deg(got.rotation, FRAMES["anything"]) < 1.0
    assert got.inlier_share == pytest.approx(0.8)


def test_the_shared_chamfer_is_that_of_the_turned_prediction():
    rng = np.random.default_rng(0)
    cloud, surface = rng.normal(size=(30, 3)), rng.normal(size=(40, 3))
    turn = FRAMES["anything"]
    gaps = cdist(turn.apply(cloud), surface)
    expected = gaps.min(axis=1).mean() + gaps.min(axis=0).mean()
    got = alignments.shared_chamfer([(KDTree(cloud), KDTree(surface))] * 2, wxyz(turn))
    assert got == pytest.approx(expected, rel=1e-12)  # float64 throughout


def test_shapes_decide_where_flips_are_nearly_even():
    # 55 % of the views are turned about z; the shapes are not, and settle it.
    got = align(*scene(FRAMES["anything"], flips=0.55, noise_deg=4.0))
    assert gap_deg(got.rotation, FRAMES["anything"]) < 2.5
    assert got.inlier_share == pytest.approx(0.45)


def test_shapes_do_not_overrule_a_clear_vote():
    # Poses say identity for 90 % of the views; the shapes are all turned round.
    predicted, truth, points, surfaces = scene(Rotation.identity(), flips=0.1)
    turned = HALF_TURN_Z.apply(points.reshape(-1, 3)).reshape(points.shape)
    got = align(predicted, truth, turned, surfaces)
    assert got.inlier_share >= 0.9


def test_icp_removes_what_a_common_pose_bias_leaves():
    # Every pose is off by the same 12 degrees, so the vote cannot know; shapes do.
    frame = FRAMES["anything"]
    predicted, truth, points, surfaces = scene(frame)
    points = points[:, 0]  # one cloud per model is enough
    bias = Rotation.from_rotvec(np.radians([12.0, 0.0, 0.0]))
    biased = wxyz(to_scipy(truth) * bias * frame).reshape(predicted.shape)
    got = align(biased, truth, points, surfaces)
    # Subsampled clouds of 400 points, 8 of them: about a degree.
    assert gap_deg(got.rotation, frame) < 2.0


def test_icp_is_not_taken_where_it_would_not_lower_the_chamfer_distance(monkeypatch):
    worse = wxyz(Rotation.from_rotvec([0.0, 0.0, 0.5]))
    monkeypatch.setattr(alignments, "fit_rotation", lambda pairs, start: worse)
    got = align(*scene(Rotation.identity(), noise_deg=1.0))
    assert gap_deg(got.rotation, Rotation.identity()) < 2.0


def test_two_views_half_a_turn_apart_give_one_of_them_not_nan():
    q = np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0]])
    best = find_modes(q)[0].rotation
    # The other one weighs 5e-5 and lies where it pulls nowhere; 1e-3 degrees is ample.
    assert min(gap_deg(best, to_scipy(r)) for r in q) < 1e-3


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_a_cloud_shrunk_to_a_point_gives_a_rotation_without_a_warning(place):
    cloud = np.full((5, 3), place)
    surface = cloud + np.random.default_rng(0).uniform(-0.1, 0.1, (5, 3))
    pair = KDTree(cloud), KDTree(surface)
    fitted = alignments.fit_rotation([pair], wxyz(Rotation.identity()))
    assert np.linalg.norm(fitted) == pytest.approx(1.0, rel=1e-12)  # float64


def test_aligned_shape_and_pose_give_the_same_picture_as_before():
    frame, pose = Rotation.random(2, random_state=9)
    alignment = alignments.identity_alignment()._replace(rotation=wxyz(frame))
    points = np.random.default_rng(0).normal(size=(6, 3))
    moved = alignments.align_points(alignment, points)
    np.testing.assert_allclose(moved, frame.apply(points), atol=1e-14)  # float64
    aligned = alignments.align_poses(alignment, wxyz(pose))
    back = to_scipy(aligned).apply(moved)
    np.testing.assert_allclose(back, pose.apply(points), atol=1e-14)


def test_arguments_that_do_not_fit_together_are_refused_in_a_sentence():
    predicted, truth, points, surfaces = scene(Rotation.identity(), models=2)
    with pytest.raises(ValueError, match=r"points \[n, V, N, 3\]"):
        align(predicted, truth, points[:, :3], surfaces)
    with pytest.raises(ValueError, match="at least one model"):
        align(predicted[:0], truth[:0], points[:0], surfaces[:0])
    with pytest.raises(ValueError, match="finite coordinates in points"):
        align(predicted, truth, points * np.nan, surfaces)
