"""What wrong views are: half turns, mirror poses, objects wrong in all their views.

A silhouette under orthographic projection is the same from the mirror pose: that of the
object mirrored left to right, in an image mirrored along the view. For an object that
is its own mirror image the pose K·R·M has it too, with K = diag(1, 1, -1) in the camera
frame and M = diag(1, -1, 1) in the object's: azimuth φ becomes 180° - φ, the elevation
changes its sign. A half turn about the up axis exchanges front and back.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.pose import ACCURACY_THRESHOLD_DEG

KINDS = ("half turn", "other half turn", "mirror pose", "other")
_ALONG, _ACROSS = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, -1.0, 1.0])


class Failures(NamedTuple):
    """What is wrong with the poses of a test set.

    Attributes:
      kinds: [n, V] index into `KINDS` of each wrong view; -1 of right ones.
      wrong_objects: [k] indices of objects that are wrong in all their views, of which
        there are at least two.
      metrics: shares from 0 to 1: `wrong_half_turn_share`, `wrong_mirror_share` and
        `truth_cheaper_share` of the wrong views, `wrong_object_share` of the objects;
        without wrong views the first three are left out, and the third without costs.
    """

    kinds: np.ndarray
    wrong_objects: np.ndarray
    metrics: dict[str, float]


def find_failures(
    predicted: ArrayLike,
    true: ArrayLike,
    *,
    costs: ArrayLike | None = None,
    threshold_deg: float = ACCURACY_THRESHOLD_DEG,
) -> Failures:
    """Sort the wrong views by what they are near to.

    A view is wrong by more than the threshold. It is of the first kind whose pose it is
    within the threshold of.

    Args:
      predicted, true: [n, V, 4] quaternions, object frame to camera.
      costs: [n, V, 2] of each view's silhouette with the predicted shape, from the
        predicted pose and from the true one.

    Raises:
      ValueError: for shapes that do not fit, or quaternions that are none.
    """
    if np.shape(predicted) != np.shape(true) or np.ndim(predicted) != 3:
        raise ValueError(
            "Expected predicted and true poses [n, V, 4], but their shapes are "
            f"{np.shape(predicted)} and {np.shape(true)}; pass one of each view."
        )
    found = rotations.to_rotation(predicted)
    wrong = rotations.angle_deg(predicted, true) > threshold_deg
    kinds = np.where(wrong, len(KINDS) - 1, -1)
    for kind, others in reversed(list(enumerate(_list_alternatives(true)))):
        away = [np.degrees((found * other.inv()).magnitude()) for other in others]
        kinds = np.where(wrong & (np.min(away, axis=0) <= threshold_deg), kind, kinds)
    is_lost = wrong.all(axis=1) & (wrong.shape[1] > 1)
    metrics = {"wrong_object_share": float(np.mean(is_lost))}
    if wrong.any():
        metrics["wrong_half_turn_share"] = float(np.mean(kinds[wrong] == 0))
        metrics["wrong_mirror_share"] = float(np.mean(kinds[wrong] == 2))
    if wrong.any() and costs is not None:
        chosen, right = np.moveaxis(np.asarray(costs), -1, 0)
        metrics["truth_cheaper_share"] = float(np.mean((right < chosen)[wrong]))
    return Failures(kinds, np.flatnonzero(is_lost), metrics)


def _list_alternatives(true: ArrayLike) -> list[list[Rotation]]:
    """Rotations [n, V] that a wrong view may be near, in the order of `KINDS`."""
    pose = rotations.to_rotation(true)
    front, across, up = (Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3))
    mirrored = Rotation.from_matrix(_ALONG @ pose.as_matrix() @ _ACROSS)
    return [[pose * up], [pose * front, pose * across], [mirrored]]
