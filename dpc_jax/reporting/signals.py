"""Rendered images beside those of the data: silhouette, depth and colour."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize

from dpc_jax.reporting import style
from dpc_jax.reporting.examples import Example, SignalImages

_EMPTY = "#eef1f4"  # the background of depths
_DEPTH_DIFFERENCE = 0.25  # box diagonals at the ends of the scale
_SIZE = 1.2  # inches, of an image
_UNITS = {
    "depth": "depth (box diagonals)",
    "depth difference": "nearer – farther",
    "silhouette difference": "missing – too much",
    "color difference": "same – other colour",
}


def draw_signals(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid of images, a row per example, after its input three for each signal.

    These are the target, the render from the predicted pose, and their difference. Of
    silhouettes and depths it is signed: red where the render is too large or too far,
    blue where it is too small or too near. Depths are in box diagonals from the camera,
    on one scale for all rows; the background is grey. The difference of colours is
    their distance, black for none.

    Args:
      examples: at least one, all with images of the same signals.
    """
    names = list(examples[0].signals)
    columns, rows = 1 + 3 * len(names), len(examples)
    figure = style.make_figure(_SIZE * columns, _SIZE * rows * 1.1 + 0.8)
    cells = figure.add_gridspec(rows + 1, columns, height_ratios=[1] * rows + [0.35])
    limits = _find_depths(examples)
    titles = ["input"]
    for name in names:
        titles += [f"{name}, {what}" for what in ("target", "rendered", "difference")]
    scales = {}  # (image, its first column, the one after)
    for number, example in enumerate(examples):
        row = [figure.add_subplot(cells[number, i]) for i in range(columns)]
        style.show_picture(row[0], example.image)
        label = style.spell_name(example.name)
        row[0].set_xlabel(label, fontsize=7, color=style.INK, loc="left")
        for first, name in zip(range(1, columns, 3), names, strict=True):
            shown = _DRAWINGS[name](row[first:], example.signals[name], limits)
            for scale, image in shown.items():
                part = (2, 3) if scale.endswith("difference") else (0, 2)
                scales[scale] = (image, first + part[0], first + part[1])
        for axes, title in zip(row, titles if number == 0 else (), strict=False):
            axes.set_title(title, fontsize=7, color=style.INK)
    for name, (image, first, last) in scales.items():
        frame = figure.add_subplot(cells[rows, first:last])
        frame.set_axis_off()
        bar_axes = frame.inset_axes((0.05, 0.6, 0.9, 0.25))
        bar = figure.colorbar(image, cax=bar_axes, orientation="horizontal")
        bar.ax.tick_params(labelsize=7, colors=style.INK)
        bar.set_label(_UNITS[name], fontsize=7, color=style.INK)
    return style.save_figure(figure, path)


def _find_depths(examples):
    """A scale from the smallest to the largest depth of what the true masks cover."""
    found = [e.signals["depth"] for e in examples if "depth" in e.signals]
    values = np.concatenate([*(s.target[s.mask >= 0.5] for s in found), np.zeros(0)])
    return Normalize(values.min(), values.max()) if values.size else Normalize(1.5, 2.5)


def _draw_silhouette(cells, images: SignalImages, _):
    style.show_picture(cells[0], images.target)
    style.show_picture(cells[1], images.predicted)
    away, look = images.predicted - images.target, {"cmap": "RdBu_r", "vmin": -1.0}
    return {"silhouette difference": style.show_picture(cells[2], away, **look)}


def _draw_depth(cells, images: SignalImages, scale):
    look = {"cmap": colormaps["viridis_r"].with_extremes(bad=_EMPTY), "norm": scale}
    target = np.ma.masked_where(images.mask < 0.5, images.target)
    style.show_picture(cells[0], target, **look)
    seen = np.ma.masked_where(images.opacity < 0.5, images.predicted)
    shown = style.show_picture(cells[1], seen, **look)
    away = np.ma.masked_where(images.mask < 0.5, images.predicted - images.target)
    look = {"cmap": colormaps["RdBu_r"].with_extremes(bad=_EMPTY)}
    look |= {"norm": Normalize(-_DEPTH_DIFFERENCE, _DEPTH_DIFFERENCE)}
    difference = style.show_picture(cells[2], away, **look)
    return {"depth": shown, "depth difference": difference}


def _draw_color(cells, images: SignalImages, _):
    style.show_picture(cells[0], np.clip(images.target, 0.0, 1.0))
    style.show_picture(cells[1], np.clip(images.predicted, 0.0, 1.0))
    away = np.sqrt(np.mean((images.predicted - images.target) ** 2, axis=-1))
    return {"color difference": style.show_picture(cells[2], away, vmax=0.5)}


_DRAWINGS = {"silhouette": _draw_silhouette, "depth": _draw_depth, "color": _draw_color}
