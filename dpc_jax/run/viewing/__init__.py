"""What the live view shows: shapes, and the views that they are seen in."""

from typing import NamedTuple

import numpy as np


class Candidates(NamedTuple):
    """What the ensemble proposes for a view.

    Attributes:
      poses: [C, 4] object to camera. probabilities: [C] by the student.
      losses: [C] of the silhouette, squared differences summed.
    """

    poses: np.ndarray
    probabilities: np.ndarray
    losses: np.ndarray


class ShownView(NamedTuple):
    """A view of an object.

    Attributes:
      pose: [4] object to camera. image: uint8 [S, S, 3].
      silhouette: [D, D] of the shape from that pose, 0 to 1.
    """

    pose: np.ndarray
    image: np.ndarray | None = None
    silhouette: np.ndarray | None = None
    candidates: Candidates | None = None


class ShownObject(NamedTuple):
    """A cloud, a surface or both, in the object frame: z up, x front.

    Attributes:
      points: [N, 3]. colors: [N, 3] of 0 to 1, sRGB.
      surface: content of a GLB file; None to wrap the points.
    """

    name: str
    points: np.ndarray | None = None
    colors: np.ndarray | None = None
    surface: bytes | None = None
    views: tuple[ShownView, ...] = ()
