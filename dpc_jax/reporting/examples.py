"""A test view with its prediction, as the report shows it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Example:
    """One test view and its prediction."""

    name: str  # of the model and view; names its point cloud files, too
    image: np.ndarray  # [S, S, 3] uint8, what the network saw
    target: np.ndarray  # [S, S] true silhouette, 0 to 1
    predicted: np.ndarray  # [S, S] predicted silhouette, 0 to 1; its size may differ
    points: np.ndarray  # [N, 3] predicted shape, object frame (z up, x front)
    colors: np.ndarray | None  # [N, 3] predicted, bytes or floats 0 to 1
    pose_error_deg: float | None  # None where the true pose is unknown
    surface: np.ndarray | None = None  # [P, 3] points of the true shape, for comparison
