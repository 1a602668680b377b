"""A test view with its prediction, as the report shows it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Example:
    """One test view and its prediction.

    Attributes:
      name: of the model and view; names its point cloud files, too.
      image: [S, S, 3] uint8, what the network saw.
      target: [S, S] true silhouette, 0 to 1.
      predicted: [S, S] silhouette of the prediction, 0 to 1; its size may differ.
      points: [N, 3] predicted shape, object frame (z up, x front).
      colors: [N, 3] predicted colours, bytes or floats 0 to 1; None without colour.
      pose_error_deg: of the predicted pose, degrees; None where the true one is
        unknown.
      surface: [P, 3] points of the true shape, shown beside the prediction; or None.
    """

    name: str
    image: np.ndarray
    target: np.ndarray
    predicted: np.ndarray
    points: np.ndarray
    colors: np.ndarray | None
    pose_error_deg: float | None
    surface: np.ndarray | None = None
