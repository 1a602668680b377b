"""What the live view shows: shapes, and the views that they are seen in."""

from typing import NamedTuple

import numpy as np


class Candidates(NamedTuple):
    """What the ensemble proposes for a view."""

    poses: np.ndarray  # [C, 4] object to camera
    probabilities: np.ndarray  # [C] by the student
    losses: np.ndarray  # [C] of the silhouette, squared differences summed


class ShownView(NamedTuple):
    """A view of an object."""

    pose: np.ndarray  # [4] object to camera
    image: np.ndarray | None = None  # uint8 [S, S, 3]
    silhouette: np.ndarray | None = None  # [D, D] of the shape from that pose, 0 to 1
    candidates: Candidates | None = None


class ShownObject(NamedTuple):
    """A cloud, a surface or both, in the object frame: z up, x front."""

    name: str
    points: np.ndarray | None = None  # [N, 3]
    colors: np.ndarray | None = None  # [N, 3] of 0 to 1, sRGB
    surface: bytes | None = None  # content of a GLB file; None to wrap the points
    views: tuple[ShownView, ...] = ()
