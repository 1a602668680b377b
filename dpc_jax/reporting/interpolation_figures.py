"""Figures of shapes between shapes: strips of clouds, and one animated picture."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax.reporting.panels import draw_grid, write_animation
from dpc_jax.reporting.spheres import FRONT, REAR, draw_cloud

_STRIP, _FRAME, _INSET = 256, 300, 76  # sides of pictures, pixels
_BAR = 8  # height of the bar that tells how far a frame is, pixels
_REST, _MOVE = 600, 80  # how long a prediction and a frame between stay, milliseconds
_FILLED, _EMPTY = (47, 126, 188), (222, 228, 234)


def draw_strips(
    starts: Sequence[np.ndarray] | np.ndarray,
    clouds: Sequence[np.ndarray] | np.ndarray,
    stops: Sequence[np.ndarray] | np.ndarray,
    path: str | os.PathLike,
) -> Path:
    """A row for each pair: input A, clouds from A to B, input B (the paper's figure).

    Args:
      starts, stops: inputs uint8 [S, S, 3] of each pair.
      clouds: [F, N, 3] of each pair in the object frame, A first and B last.
    """
    rows = []
    for start, between, stop in zip(starts, clouds, stops, strict=True):
        pictures = [draw_cloud(cloud, size=_STRIP) for cloud in between]
        rows.append([start, *pictures, stop])
    last = len(clouds[0]) - 1
    middle = [f"{100 * i / last:.0f} % of the way" for i in range(1, last)]
    titles = ["input A", "prediction A", *middle, "prediction B", "input B"]
    return draw_grid(rows, path, titles=titles)


def animate_tour(
    images: Sequence[np.ndarray] | np.ndarray,
    clouds: np.ndarray,
    path: str | os.PathLike,
) -> Path:
    """An endless GIF from one input's shape to the next and back to the first.

    Each frame shows the cloud from the front and from the rear, the inputs that it is
    between, and how far it has come.

    Args:
      images: uint8 [S, S, 3], n inputs.
      clouds: [n, F, N, 3] in the object frame; row i goes from input i, at its first
        frame, towards input i + 1, which is the first frame of the next row.
    """
    count, steps = clouds.shape[:2]
    frames = []
    for i, step in np.ndindex(count, steps):
        ends = images[i], images[(i + 1) % count]
        frames.append(_draw_frame(clouds[i, step], ends, share=step / steps))
    times = [_REST if i % steps == 0 else _MOVE for i in range(len(frames))]
    return write_animation(frames, path, milliseconds=times)


def _draw_frame(cloud, ends, *, share) -> np.ndarray:
    sides = [draw_cloud(cloud, view_deg=view, size=_FRAME) for view in (FRONT, REAR)]
    picture = np.concatenate(sides, axis=1)
    inputs = [
        np.array(
            Image.fromarray(end).resize((_INSET, _INSET), Image.Resampling.BICUBIC)
        )
        for end in ends
    ]
    for inset, place in zip(
        inputs, (np.s_[:, :_INSET], np.s_[:, -_INSET:]), strict=True
    ):
        corner = picture[:_INSET][place]
        corner[:] = np.minimum(corner, inset)
    bar = np.full((_BAR, picture.shape[1], 3), _EMPTY, np.uint8)
    bar[:, : round(share * picture.shape[1])] = _FILLED
    return np.concatenate([picture, bar])
