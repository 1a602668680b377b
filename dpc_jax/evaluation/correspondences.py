"""Semantic correspondences between predicted clouds, by the indices of their points.

§ Discovery of semantic correspondences: the point of one output unit tends to be on the
same part of every object. Keypoints are marked on two templates; the indices of the
predicted points near them, in both templates, are looked up in other clouds.

The paper shows pictures. Where the true surface comes with labels of its parts, what
was transferred can be measured, too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import check_points

Indices = Sequence[np.ndarray]  # for each of K keypoints the indices [n_k] of points


class Transfer(NamedTuple):
    """Where the points of K keypoints are in one cloud; NaN for a keypoint without any.

    Attributes:
      right: [K] share of the points whose nearest true surface belongs to the
        keypoint's part, 0 to 1.
      distance: [K] mean distance to the shape's own keypoint, object units; NaN where
        the shape has none.
      centre: [K, 3] of the points.
    """

    right: np.ndarray
    distance: np.ndarray
    centre: np.ndarray


def select_indices(
    templates: ArrayLike, keypoints: ArrayLike, *, radius: float, least: int = 1
) -> list[np.ndarray]:
    """Indices of the points that are near a keypoint in every template.

    Args:
      templates: [T, N, 3] predicted clouds.
      keypoints: [T, K, 3] the keypoints of each template, in the same frame.
      radius: how near, in object units.
      least: points that a keypoint should have. Where fewer agree within the radius, it
        becomes the smallest one within which so many do.

    Returns:
      For each of the K keypoints the indices [n_k], rising, n_k at least `least`.

    Raises:
      ValueError: for shapes that do not fit together, or `least` not in 1 to N.
    """
    clouds, marks = np.asarray(templates, float), np.asarray(keypoints, float)
    fits = clouds.ndim == marks.ndim == 3 and len(clouds) == len(marks) > 0
    if not fits or clouds.shape[-1] != 3 or marks.shape[-1] != 3:
        raise ValueError(
            f"Expected templates [T, N, 3] and keypoints [T, K, 3], but the shapes are "
            f"{clouds.shape} and {marks.shape}; pass one row of keypoints for each "
            "template."
        )
    if not 1 <= least <= clouds.shape[1]:
        raise ValueError(
            f"least must be between 1 and {clouds.shape[1]}, the number of points, but "
            f"it is {least}; change it."
        )
    # Near in every template is near in the one where a point is farthest.
    away = np.linalg.norm(clouds[:, None] - marks[:, :, None], axis=-1).max(axis=0)
    reach = np.maximum(radius, np.partition(away, least - 1, axis=-1)[:, least - 1])
    return [np.flatnonzero(row <= r) for row, r in zip(away, reach, strict=True)]


def select_nearest(
    cloud: ArrayLike, positions: ArrayLike, counts: Sequence[int]
) -> list[np.ndarray]:
    """For each position [K, 3] the indices of that many points of a cloud near it.

    A baseline: it transfers places instead of indices. None for a position of NaN.
    """
    points, places = np.asarray(cloud), np.asarray(positions)
    away = np.linalg.norm(points - places[:, None], axis=-1)  # NaN where not known
    return [
        np.argpartition(row, count - 1)[:count] if row[0] >= 0 else np.zeros(0, int)
        for row, count in zip(away, counts, strict=True)
    ]


def label_points(
    points: ArrayLike, surface: ArrayLike, labels: Sequence[str] | np.ndarray
) -> np.ndarray:
    """The label [N] of the true surface that is nearest to each point [N, 3].

    Args:
      surface: [P, 3] points, close together, with their labels [P].
    """
    tree = KDTree(check_points(surface, name="surface"))
    _, nearest = tree.query(check_points(points, name="points"))
    return np.asarray(labels)[nearest]


def measure_transfer(
    cloud: np.ndarray,
    found: Indices,
    *,
    point_labels: np.ndarray,
    labels: Sequence[str],
    keypoints: np.ndarray,
) -> Transfer:
    """What became of K keypoints in one cloud.

    Args:
      cloud: [N, 3] in the object frame. found: K arrays of indices into it.
      point_labels: [N], of `label_points`. labels: of the K keypoints.
      keypoints: [K, 3] of the shape itself; NaN where it has none.
    """
    right, distance, centre = [], [], []
    for index, label, keypoint in zip(found, labels, keypoints, strict=True):
        points = cloud[index] if len(index) else np.full((1, 3), np.nan)
        centre.append(points.mean(axis=0))
        distance.append(np.linalg.norm(points - keypoint, axis=-1).mean())
        right.append(np.mean(point_labels[index] == label) if len(index) else np.nan)
    return Transfer(np.array(right), np.array(distance), np.array(centre))


def measure_following(moves: ArrayLike, true_moves: ArrayLike) -> float:
    """How far points move with their keypoint from template to shape: 1 as far, 0 not.

    It is the slope of the regression of the moves on the true moves [..., 3], without a
    constant. Moves with NaN are left out; NaN where nothing moves.
    """
    moves, truth = np.asarray(moves, float), np.asarray(true_moves, float)
    known = np.isfinite(moves + truth).all(axis=-1)
    length = np.sum(truth[known] ** 2)
    return float(np.sum(moves[known] * truth[known]) / length) if length > 0 else np.nan
