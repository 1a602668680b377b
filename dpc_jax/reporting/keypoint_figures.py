"""Figures of semantic correspondences: coloured points in clouds, shares in bars."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax.reporting import style
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


def draw_shares(
    shares: Mapping[str, Mapping[str, float]], path: str | os.PathLike
) -> Path:
    """Bars: the share of points on the right part, for each method and keypoint.

    Args:
      shares: method: {keypoint: share of 0 to 1}; NaN has no bar.
    """
    names = list(next(iter(shares.values())))
    figure = style.make_figure(9.0, 3.4)
    axes = figure.subplots()
    width = 0.8 / len(shares)
    for i, (method, values) in enumerate(shares.items()):
        percent = 100.0 * np.array([values[name] for name in names])
        places = np.arange(len(names)) + (i - (len(shares) - 1) / 2) * width
        axes.bar(places, percent, width, color=style.SERIES[i], label=method)
    style.label_axes(
        axes, title="Transferred points on the right part", y_label="share (%)"
    )
    lines = [name.replace(" ", "\n") for name in names]
    axes.set_xticks(np.arange(len(names)), lines)
    axes.set_ylim(0.0, 100.0)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return style.save_figure(figure, path)
