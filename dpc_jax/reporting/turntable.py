"""A cloud that turns: an animated picture of lit spheres."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from dpc_jax.files import write_bytes
from dpc_jax.reporting.spheres import draw_spheres, shade_depth

FRAMES = 36  # of a whole turn
_ELEVATION = 20.0  # of the viewer, degrees
_MILLISECONDS = 80  # of a frame: a turn takes three seconds
_COLORS = 64  # of the palette: spheres have few, and the file stays small


def draw_turntable(
    points: ArrayLike, colors: ArrayLike | None = None, *, size: int = 320
) -> list[np.ndarray]:
    """`FRAMES` pictures uint8 [size, size, 3] of points [N, 3] from all around.

    Args:
      points: in the object frame, z up. colors: [N, 3] of 0 to 1, or None for depth.
    """
    cloud, frames = np.asarray(points, np.float64), []
    # Many points are drawn smaller, so that they do not melt into one.
    radius = 0.012 * min(1.0, (2000 / max(len(cloud), 1)) ** 0.5)
    for number in range(FRAMES):
        view = 35.0 + 360.0 * number / FRAMES, _ELEVATION
        paint = shade_depth(cloud, view) if colors is None else colors
        frames.append(
            draw_spheres(cloud, paint, view_deg=view, radius=radius, size=size)
        )
    return frames


def write_turntable(path: Path, points: ArrayLike, colors: ArrayLike | None = None):
    """An animated GIF or WebP, by the suffix of the path; it plays without end."""
    frames = [Image.fromarray(frame) for frame in draw_turntable(points, colors)]
    buffer = io.BytesIO()
    kind = path.suffix[1:].lower()
    if kind == "gif":
        palette = frames[0].quantize(_COLORS)
        frames = [
            frame.quantize(palette=palette, dither=Image.Dither.NONE)
            for frame in frames
        ]
    frames[0].save(
        buffer,
        format=kind.upper(),
        save_all=True,
        append_images=frames[1:],
        duration=_MILLISECONDS,
        loop=0,
    )
    write_bytes(path, buffer.getvalue())
