"""A test view with its prediction, as the report shows it."""

from dataclasses import dataclass

import numpy as np

from dpc_jax.evaluation.images import ViewImages
from dpc_jax.evaluation.metrics import format_metric


@dataclass(frozen=True)
class Neighbour:
    """A shape that the network did not predict, shown beside one that it did."""

    title: str  # what it is: "Nearest training shape"
    points: np.ndarray  # [N, 3] object frame
    chamfer: float  # times 100, to the true shape


@dataclass(frozen=True)
class Example:
    """One test view and its prediction."""

    name: str  # of the model and view; names its point cloud files, too
    image: np.ndarray  # [S, S, 3] uint8, what the network saw
    target: np.ndarray  # [S, S] true silhouette, 0 to 1
    predicted: np.ndarray  # [S, S] predicted silhouette, 0 to 1; its size may differ
    points: np.ndarray  # [N, 3] predicted shape, object frame (z up, x front)
    colors: np.ndarray | None  # [N, 3] predicted, 0 to 1
    pose_error_deg: float | None = None  # None where the true pose is unknown
    surface: np.ndarray | None = None  # [P, 3] points of the true shape, for comparison
    # Vertices [V, 3] and faces [F, 3] of a predicted surface, of voxel models.
    mesh: tuple[np.ndarray, ...] | None = None
    images: ViewImages | None = None  # of all signals
    group: str = ""  # of the examples that are shown together: "Worst", for instance
    chamfer: float | None = None  # times 100; None without a true shape
    overlap: float | None = None  # of silhouettes, intersection over union, 0 to 1
    neighbours: tuple[Neighbour, ...] = ()

    @property
    def title(self) -> str:
        """Its group and name: "Worst: car-3, view 2"."""
        return f"{self.group}: {self.name}" if self.group else self.name

    def list_measures(self) -> list[str]:
        """What is known of it: "pose error 12.0°"."""
        found = [
            ("pose error", "pose_median_error_deg", self.pose_error_deg, "°"),
            ("silhouette overlap", "silhouette_iou", self.overlap, " %"),
            ("Chamfer distance", "chamfer", self.chamfer, ""),
            *((near.title, "chamfer", near.chamfer, "") for near in self.neighbours),
        ]
        return [
            f"{label} {format_metric(metric, value)}{unit}"
            for label, metric, value, unit in found
            if value is not None
        ]
