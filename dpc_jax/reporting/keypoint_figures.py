"""Figures of semantic correspondences: coloured points in clouds."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax.reporting.panels import draw_grid
from dpc_jax.reporting.spheres import FRONT, draw_spheres, shade_depth

_COLUMNS = 6  # as in the paper
_SIDE, _INSET = 320, 84  # of a picture and of the input in its corner, pixels
_PLAIN, _MARKED = 0.010, 0.021  # radii of the spheres, object units
_COLORS = (
    "#e6194b", "#3cb44b", "#ffb000", "#4363d8", "#f06a1d", "#911eb4",
    "#1fb8c4", "#f032e6", "#8db600", "#7a4a1e", "#008080", "#000075",
)  # fmt: skip


def draw_transfers(
    images: Sequence[np.ndarray] | np.ndarray,
    clouds: Sequence[np.ndarray] | np.ndarray,
    found: Sequence[np.ndarray],
    path: str | os.PathLike,
    *,
    templates: int,
) -> Path:
    """Clouds in which the points of each keypoint have one colour (the paper's Fig. 7).

    Args:
      images: uint8 [S, S, 3], the input of each cloud, shown in its corner.
      clouds: [N, 3] in the object frame.
      found: for each keypoint the indices of its points.
      templates: how many of the first clouds are templates, which get a frame.
    """
    pictures = [
        _draw_cloud(image, cloud, found)
        for image, cloud in zip(images, clouds, strict=True)
    ]
    pictures += [None] * (-len(pictures) % _COLUMNS)
    rows = [pictures[i : i + _COLUMNS] for i in range(0, len(pictures), _COLUMNS)]
    return draw_grid(rows, path, titles=["template"] * templates, framed=templates)


def _draw_cloud(image, cloud, found) -> np.ndarray:
    colors = 0.35 * shade_depth(cloud, FRONT) + 0.65 * np.array([0.80, 0.82, 0.85])
    radius = np.full(len(cloud), _PLAIN)
    for i, index in enumerate(found):
        colors[index] = _to_rgb(_COLORS[i % len(_COLORS)])
        radius[index] = _MARKED
    picture = draw_spheres(cloud, colors, view_deg=FRONT, radius=radius, size=_SIDE)
    inset = Image.fromarray(image).resize((_INSET, _INSET), Image.Resampling.BICUBIC)
    picture[:_INSET, :_INSET] = np.minimum(picture[:_INSET, :_INSET], np.array(inset))
    return picture


def _to_rgb(text):
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
