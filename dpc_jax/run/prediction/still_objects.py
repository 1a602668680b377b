"""Objects that stand still before known cameras: all views share one pose."""

import numpy as np
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation.rotations import to_quaternion, to_rotation

NEAR = 30.0  # degrees between poses of different views that mean the same
UNSEEN = 0.1  # probability of a pose that a view does not think of


def agree_on_pose(
    cameras: np.ndarray,
    poses: np.ndarray,
    candidates: np.ndarray,
    probabilities: np.ndarray,
) -> np.ndarray:
    """Poses [V, 4] of an object that stands still before cameras [V, 3, 3].

    A pose of the object in the world is as likely as the student finds those near it in
    all views, and `UNSEEN` of each view at least. The likeliest is improved by the mean
    of those that views were predicted near it. Not in the paper.

    Args:
      cameras: rotations, world to camera. poses: [V, 4], predicted of single views.
      candidates: [V, C, 4]. probabilities: [V, C] of the student.
    """
    known = np.concatenate([poses[:, None], candidates], axis=1)
    to_world = Rotation.from_matrix(cameras[:, None]).inv()
    world = to_quaternion(to_world * to_rotation(known))  # [V, 1 + C, 4]
    own, tried = world[:, 0], world.reshape(-1, 4)
    least = np.cos(np.deg2rad(NEAR) / 2)
    near = np.abs(np.einsum("ti,vci->tvc", tried, world[:, 1:])) > least
    votes = np.sum(near * probabilities, axis=2)
    best = tried[np.argmax(np.sum(np.log(votes + UNSEEN), axis=1))]
    close = own[np.abs(own @ best) > least]
    agreed = to_rotation(close).mean() if len(close) else to_rotation(best)
    return to_quaternion(Rotation.from_matrix(cameras) * agreed)


def turn_to_cameras(
    poses: np.ndarray, cameras: np.ndarray, turns: np.ndarray
) -> np.ndarray:
    """Poses [V, 4] of such an object in the cameras that took its photographs.

    Refinement turns each view's pose by itself; their mean in the world is taken.

    Args:
      poses: [V, 4] in the `cameras` [V, 3, 3], which look straight at the object.
      turns: [V, 3, 3] from those that took the photographs to these.
    """
    straight = Rotation.from_matrix(cameras)
    shared = straight * (straight.inv() * to_rotation(poses)).mean()
    return to_quaternion(Rotation.from_matrix(turns).inv() * shared)
