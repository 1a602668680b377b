"""Rendered images beside those of the data: silhouette, depth and colour."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize

from dpc_jax.reporting.examples import Example, SignalImages
from dpc_jax.reporting.style import INK, make_figure, save_figure, spell_name

_EMPTY = "#eef1f4"  # the background of depths
_DEPTH_DIFFERENCE = 0.25  # box diagonals at the ends of the scale
_SIZE = 1.2  # inches, of an image


def draw_signals(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid of images, a row per example, after its input three for each signal.

    These are the target, the render from the predicted pose, and their difference. Of
    silhouettes and depths it is signed: red where the render is too large or too far,
    blue where it is too small or too near. Depths are in box diagonals from the camera,
    on one scale for all rows; the background is grey. The difference of colours is
    their distance, black for none.

    Raises:
      ValueError: there are no examples, or they have no such images.
    """
    names = list(examples[0].signals) if examples else []
    if not names:
        raise ValueError(
            "examples must be at least one with images of signals, but there are none; "
            "pass predictions with their renders."
        )
    columns, rows = 1 + 3 * len(names), len(examples)
    figure = make_figure(_SIZE * columns, _SIZE * rows * 1.1 + 0.8)
    cells = figure.add_gridspec(rows + 1, columns, height_ratios=[1] * rows + [0.35])
    limits = _find_depths(examples)
    scales = {}
    for number, example in enumerate(examples):
        row = [figure.add_subplot(cells[number, i]) for i in range(columns)]
        scales |= _draw_row(row, example, names, limits)
        if number == 0:
            _name_columns(row, names)
    for name, (image, first, last) in scales.items():
        frame = figure.add_subplot(cells[rows, first:last])
        frame.set_axis_off()
        bar_axes = frame.inset_axes((0.05, 0.6, 0.9, 0.25))
        bar = figure.colorbar(image, cax=bar_axes, orientation="horizontal")
        bar.ax.tick_params(labelsize=7, colors=INK)
        bar.set_label(_UNITS[name], fontsize=7, color=INK)
    return save_figure(figure, path)


def _draw_row(row, example, names, limits):
    """One example; returns {scale: (image, its first column, the one after)}."""
    for axes in row:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_color("#d5dbe1")
    row[0].imshow(example.image)
    row[0].set_xlabel(spell_name(example.name), fontsize=7, color=INK, loc="left")
    scales = {}
    for place, name in enumerate(names):
        first = 1 + 3 * place
        drawn = _DRAWINGS[name](row[first : first + 3], example.signals[name], limits)
        for scale, image in drawn.items():
            part = (2, 3) if scale.endswith("difference") else (0, 2)
            scales[scale] = (image, first + part[0], first + part[1])
    return scales


def _name_columns(row, names):
    titles = ["input"]
    for name in names:
        titles += [f"{name}, {what}" for what in ("target", "rendered", "difference")]
    for axes, title in zip(row, titles, strict=True):
        axes.set_title(title, fontsize=7, color=INK)


_UNITS = {
    "depth": "depth (box diagonals)",
    "depth difference": "nearer – farther",
    "silhouette difference": "missing – too much",
    "color difference": "same – other colour",
}


def _find_depths(examples):
    """Smallest and largest depth of what the true masks cover."""
    found = [e.signals["depth"] for e in examples if "depth" in e.signals]
    values = [s.target[s.mask >= 0.5] for s in found]
    joined = np.concatenate([*values, np.zeros(0)])
    return (float(joined.min()), float(joined.max())) if joined.size else (1.5, 2.5)


def _draw_silhouette(cells, images: SignalImages, _):
    for axes, image in zip(cells, (images.target, images.predicted), strict=False):
        axes.imshow(image, cmap="gray", vmin=0.0, vmax=1.0)
    away = images.predicted - images.target
    shown = cells[2].imshow(away, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    return {"silhouette difference": shown}


def _draw_depth(cells, images: SignalImages, limits):
    colors = colormaps["viridis_r"].with_extremes(bad=_EMPTY)
    scale = Normalize(*limits)
    shown = None
    for axes, image, share in (
        (cells[0], images.target, images.mask),
        (cells[1], images.predicted, images.opacity),
    ):
        seen = np.ma.masked_where(share < 0.5, image)
        shown = axes.imshow(seen, cmap=colors, norm=scale)
    away = np.ma.masked_where(images.mask < 0.5, images.predicted - images.target)
    differences = colormaps["RdBu_r"].with_extremes(bad=_EMPTY)
    limit = _DEPTH_DIFFERENCE
    found = cells[2].imshow(away, cmap=differences, vmin=-limit, vmax=limit)
    return {"depth": shown, "depth difference": found}


def _draw_color(cells, images: SignalImages, _):
    for axes, image in zip(cells, (images.target, images.predicted), strict=False):
        axes.imshow(np.clip(image, 0.0, 1.0))
    away = np.sqrt(np.mean((images.predicted - images.target) ** 2, axis=-1))
    shown = cells[2].imshow(away, cmap="gray", vmin=0.0, vmax=0.5)
    return {"color difference": shown}


_DRAWINGS = {"silhouette": _draw_silhouette, "depth": _draw_depth, "color": _draw_color}
