"""Canonical alignment: from the frame the network invented to the data set's frame.

Without pose labels a network learns shapes in some frame of its own. Before poses and
shapes are scored, one rotation A from that frame to the object frame is estimated on
validation models (paper, section Evaluation metrics and its appendix). Each of their
views votes for A = q_gt^-1 q_pred; ICP on the shapes refines the winner of the vote.

Differences from the released procedure, which yields NaN at 180 degrees and ranks a
view without correspondences best:
  1. The vote is a robust mean around its densest modes, so views with front and back
     exchanged do not pull the mean aside.
  2. One rotation is fitted to all models at once, instead of one per view and a mean.
  3. ICP's result is taken only where it lowers the Chamfer distance of these models
     and turns by no more than 30 degrees, the limit at which views count as agreeing.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.chamfer import check_points
from dpc_jax.evaluation.rotations import rotation_angle_deg

INLIER_DEG = 30.0  # a vote this near agrees: the threshold of pose accuracy
_KERNEL_DEG = 15.0  # width of the robust weight, half of the above (heuristic)
_MAX_STEPS, _TOLERANCE_DEG = 50, 1e-6  # of the robust mean
MODELS = 20  # paper: the first 20 validation models
_POINTS, _SURFACE_POINTS = 400, 1200  # drawn from each cloud and each surface
_MOST_VOTES = 1000  # views that vote where there are no shapes
_MOST_MODES = 6
_RIVAL_SHARE = 0.5  # modes with half of the best mode's votes are rivals (heuristic)
_RIVAL_GAIN = 0.05  # and win with a Chamfer distance lower by this share (heuristic)
# Of ICP.
_REACH = 0.2  # object units; points farther apart than this are no partners
_MAX_ITERATIONS = 30
_TURN_DEG = 0.01  # a smaller turn ends the search

# Search trees of a predicted cloud in the network's frame and of the true surface in
# that of the object. Only query points are turned, so each is built once.
CloudPair = tuple[KDTree, KDTree]


class Alignment(NamedTuple):
    """The rotation from the network's frame to the object frame."""

    rotation: np.ndarray  # [4] unit quaternion wxyz, w >= 0
    inlier_share: float  # of the validation views within 30 degrees of it, 0 to 1


def align(
    predicted_poses: ArrayLike,
    true_poses: ArrayLike,
    points: ArrayLike,
    surfaces: Sequence[ArrayLike] | np.ndarray | None,
) -> Alignment:
    """Estimate the canonical alignment from validation models, never from test models.

    The first 20 models are used, always with the same subsample of their points.

    Args:
      predicted_poses: [n, V, 4] quaternions, network's frame to camera.
      true_poses: [n, V, 4] quaternions, object frame to camera.
      points: [n, V, N, 3] shape predicted from each view, in the network's frame, or
        [n, N, 3] from each model's first view.
      surfaces: [n, P, 3] points of the true surfaces, object frame; or a list of
        [P_i, 3]. None where they are not known: the alignment is the mode of the votes.

    Returns:
      `Alignment`: the rotation between the frames, and how many views agree on it.

    Raises:
      ValueError: shapes that do not fit together, no model, quaternions that are zero
        or not finite, points that are not finite.

    Example:
      >>> poses, clouds = np.tile([1.0, 0, 0, 0], (2, 3, 1)), np.zeros((2, 5, 3))
      >>> float(dpc_jax.align(poses, poses, clouds, None).inlier_share)
      1.0
    """
    if surfaces is None:
        votes = _vote(predicted_poses, true_poses).reshape(-1, 4)[:_MOST_VOTES]
        return find_modes(votes)[0]
    poses, truth, clouds, surfaces = _check(
        predicted_poses, true_poses, points, surfaces
    )
    votes = _vote(poses, truth)  # [n, V, 4]
    rng = np.random.default_rng(0)
    trees = [KDTree(_draw(surface, _SURFACE_POINTS, rng)) for surface in surfaces]
    pairs = [
        [(KDTree(_draw(cloud, _POINTS, rng)), tree) for cloud in views]
        for views, tree in zip(clouds, trees, strict=True)
    ]

    everyone = [pair for views in pairs for pair in views]
    voted = _choose_mode(find_modes(votes), everyone)
    # A view far from the vote may have turned its shape with its pose: leave it out.
    agree = rotation_angle_deg(votes, voted) <= INLIER_DEG
    trusted = [
        pair
        for views, flags in zip(pairs, agree, strict=True)
        for pair, flag in zip(views, flags, strict=False)  # one cloud, many views
        if flag
    ] or everyone

    refined = fit_rotation(trusted, voted)
    before, after = (shared_chamfer(trusted, q) for q in (voted, refined))
    # ICP on poor shapes can wander off to where no pose agrees: that refines nothing.
    near = rotation_angle_deg(refined, voted) <= INLIER_DEG
    best = rotations.canonical_sign(refined if near and after < before else voted)
    agree = rotation_angle_deg(votes, best) <= INLIER_DEG
    return Alignment(best, float(agree.mean()))


def _vote(predicted_poses: ArrayLike, true_poses: ArrayLike) -> np.ndarray:
    """The alignment [..., 4] that would make each predicted pose right."""
    truth = rotations.to_rotation(true_poses)
    return rotations.to_quaternion(truth.inv() * rotations.to_rotation(predicted_poses))


def align_points(alignment: Alignment, points: ArrayLike) -> np.ndarray:
    """Points [..., 3] of the network's frame, in the object frame: A p."""
    return rotations.to_rotation(alignment.rotation).apply(points)


def align_poses(alignment: Alignment, predicted_poses: ArrayLike) -> np.ndarray:
    """Poses [..., 4] from the network's frame, as object to camera: q_pred A^-1."""
    back = rotations.to_rotation(alignment.rotation).inv()
    return rotations.to_quaternion(rotations.to_rotation(predicted_poses) * back)


def identity_alignment() -> Alignment:
    """No turn at all: for a network trained with known poses, in the object frame."""
    return Alignment(np.array([1.0, 0.0, 0.0, 0.0]), 1.0)


def _robust_mean(votes: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Mean rotation [4] of votes [n, 4] around a start [4], outliers left aside.

    Iteratively re-weighted Markley mean with the Geman-McClure weight
    1 / (1 + (angle / kernel)^2)^2: a vote 180 degrees off weighs 5e-5.
    """
    q = rotations.normalize(votes)
    mean = rotations.canonical_sign(start)
    for _ in range(_MAX_STEPS):
        ratio = rotation_angle_deg(q, mean) / _KERNEL_DEG
        weighted = rotations.to_rotation(q).mean((1.0 + ratio**2) ** -2)
        refined = rotations.to_quaternion(weighted)
        turn = rotation_angle_deg(refined, mean)
        mean = refined
        if turn < _TOLERANCE_DEG:
            break
    return mean


def find_modes(votes: ArrayLike) -> list[Alignment]:
    """Modes of votes [n, 4], at least one; the one with the largest share first.

    The vote with the most neighbours starts a robust mean; its neighbourhood is taken
    away and the rest searched again. Networks without pose labels typically have two
    modes, half a turn apart.
    """
    q = rotations.normalize(votes).reshape(-1, 4)
    near = rotation_angle_deg(q[:, None], q[None]) <= INLIER_DEG
    left = np.ones(len(q), dtype=bool)
    found: list[Alignment] = []
    while left.any() and len(found) < _MOST_MODES:
        density = np.where(left, near.sum(axis=1), -1)
        seed = int(np.argmax(density))
        mean = _robust_mean(q, q[seed])
        agree = rotation_angle_deg(q, mean) <= INLIER_DEG
        left &= ~(agree | near[seed])
        # A sparse seed can slide into a mode that is already known.
        if all(rotation_angle_deg(mean, m.rotation) > INLIER_DEG for m in found):
            found.append(Alignment(mean, float(agree.mean())))
    return sorted(found, key=lambda mode: -mode.inlier_share)


def _choose_mode(found: list[Alignment], everyone: list[CloudPair]) -> np.ndarray:
    """The mode with most votes, unless a rival fits the shapes clearly better.

    With the votes split nearly evenly between two half turns, chance would decide. A
    rotation without votes is no rival, however well it fits: poses would then be wrong.
    """
    least = _RIVAL_SHARE * found[0].inlier_share
    rivals = [mode for mode in found if mode.inlier_share >= least]
    best = rivals[0].rotation
    if len(rivals) == 1:
        return best
    lowest = shared_chamfer(everyone, best)
    for rival in rivals[1:]:
        chamfer = shared_chamfer(everyone, rival.rotation)
        if chamfer < (1.0 - _RIVAL_GAIN) * lowest:
            best, lowest = rival.rotation, chamfer
    return best


def shared_chamfer(pairs: Sequence[CloudPair], rotation: np.ndarray) -> float:
    """Mean Chamfer distance of the pairs once the predictions are turned."""
    matrix = rotations.to_rotation(rotation).as_matrix()
    total = 0.0
    for predicted, surface in pairs:
        precision, _ = surface.query(predicted.data @ matrix.T)
        coverage, _ = predicted.query(surface.data @ matrix)
        total += precision.mean() + coverage.mean()
    return float(total / len(pairs))


def fit_rotation(pairs: Sequence[CloudPair], start: np.ndarray) -> np.ndarray:
    """One rotation [4] for all pairs, at least one, by point-to-point ICP from a start.

    It turns the network's frame to the object frame, without translation: both share
    their origin. It is the start itself where fewer than two points have a partner
    within reach, which determines no rotation.
    """
    rotation = rotations.normalize(start)
    for _ in range(_MAX_ITERATIONS):
        source, target, weight = _match(pairs, rotation)
        if len(weight) < 2:
            break
        with warnings.catch_warnings():
            # Points on a line, as a collapsed network predicts them: any turn about it
            # is as good, and one of them comes.
            warnings.filterwarnings("ignore", "Optimal rotation is not uniquely")
            best = Rotation.align_vectors(target, source, weights=weight)[0]
        refined = rotations.to_quaternion(best)
        turn = rotation_angle_deg(refined, rotation)
        rotation = refined
        if turn < _TURN_DEG:
            break
    return rotation


def _match(pairs: Sequence[CloudPair], rotation: np.ndarray) -> list[np.ndarray]:
    """Predicted points [n, 3], their nearest surface points [n, 3], and weights [n].

    From prediction to surface and back, within reach; each pair and each way weighs the
    same. With the predictions alone as queries a part could slide along the surface.
    """
    matrix = rotations.to_rotation(rotation).as_matrix()
    found = []
    for predicted, surface in pairs:
        near, index, weight = _find_partners(surface, predicted.data @ matrix.T)
        found.append((predicted.data[near], surface.data[index], weight))
        near, index, weight = _find_partners(predicted, surface.data @ matrix)
        found.append((predicted.data[index], surface.data[near], weight))
    return [np.concatenate(part) for part in zip(*found, strict=True)]


def _find_partners(tree, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points have a partner in the tree, its index, and the weight of each."""
    gap, index = tree.query(points, distance_upper_bound=_REACH)
    near = np.isfinite(gap)
    return near, index[near], np.full(near.sum(), 1.0 / near.size)


def _draw(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    if len(points) <= count:
        return points
    return points[rng.permutation(len(points))[:count]]


def _check(predicted_poses, true_poses, points, surfaces):
    """Those of the first models, after a check that they fit together."""
    poses = np.asarray(predicted_poses, np.float64)
    truth = np.asarray(true_poses, np.float64)
    clouds = np.asarray(points)
    surfaces = [np.asarray(surface) for surface in surfaces]
    if clouds.ndim == 3:
        clouds = clouds[:, None]
    fits = (
        poses.ndim == 3
        and poses.shape == truth.shape
        and clouds.ndim == 4
        and clouds.shape[1] in (1, poses.shape[1])
        and clouds.shape[-1] == 3
        and all(s.ndim == 2 and s.shape[1] == 3 and len(s) for s in surfaces)
        and len(poses) == len(clouds) == len(surfaces)
        and min(poses.size, clouds.size, len(surfaces)) > 0
    )
    if not fits:
        raise ValueError(
            f"Expected poses [n, V, 4] twice, points [n, V, N, 3] or [n, N, 3] and "
            f"surfaces [n, P, 3] of at least one model, but the shapes are "
            f"{poses.shape}, {truth.shape}, {np.shape(points)}, "
            f"{[s.shape for s in surfaces[:3]]}; pass validation models, all with the "
            f"same number of views."
        )
    clouds = clouds[:MODELS].astype(np.float64)
    check_points(clouds.reshape(-1, 3), name="points")
    surfaces = [check_points(s, name="surfaces") for s in surfaces[:MODELS]]
    return poses[:MODELS], truth[:MODELS], clouds, surfaces
