"""A cloud that turns: an animated picture of lit spheres."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.reporting.panels import write_animation
from dpc_jax.reporting.spheres import FRONT, draw_cloud

FRAMES = 36  # of a whole turn
_ELEVATION = 20.0  # of the viewer, degrees


def draw_turntable(
    points: ArrayLike, colors: ArrayLike | None = None, *, size: int = 320
) -> list[np.ndarray]:
    """`FRAMES` pictures uint8 [size, size, 3] of points [N, 3] from all around.

    Args:
      points: in the object frame, z up. colors: [N, 3] of 0 to 1, or None for depth.
    """
    azimuths = FRONT[0] + np.arange(FRAMES) * 360.0 / FRAMES
    return [
        draw_cloud(points, colors, view_deg=(azimuth, _ELEVATION), size=size)
        for azimuth in azimuths
    ]


def write_turntable(path: Path, points: ArrayLike, colors: ArrayLike | None = None):
    """An animated GIF or WebP, by the suffix of the path; it plays without end."""
    write_animation(draw_turntable(points, colors), path)
