"""Rendered images beside those of the data: silhouette, depth and colour."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize

from dpc_jax.evaluation.images import ViewImages
from dpc_jax.reporting import style
from dpc_jax.reporting.examples import Example

_EMPTY = "#eef1f4"  # the background of depths
_DEPTH_DIFFERENCE = 0.25  # box diagonals at the ends of the scale
_SIZE = 1.2  # inches, of an image
# By signal the colour bars: from which of its three columns to which, and their label.
_BARS = {
    "silhouette": [(2, 3, "missing – too much")],
    "depth": [(0, 2, "depth (box diagonals)"), (2, 3, "nearer – farther")],
    "color": [(2, 3, "same – other colour")],
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
    every = [example.images for example in examples if example.images]
    names = list(every[0].rendered)
    columns, rows = 1 + 3 * len(names), len(examples)
    figure = style.make_figure(_SIZE * columns, _SIZE * rows * 1.1 + 0.8)
    cells = figure.add_gridspec(rows + 1, columns, height_ratios=[1] * rows + [0.35])
    limits = _find_depths(every)
    titles = ["input"]
    for name in names:
        titles += [f"{name}, {what}" for what in ("target", "rendered", "difference")]
    bars = {}  # their image and label by (first column, the one after)
    for number, (example, images) in enumerate(zip(examples, every, strict=True)):
        row = [figure.add_subplot(cells[number, i]) for i in range(columns)]
        style.show_picture(row[0], example.image)
        label = style.spell_name(example.name)
        row[0].set_xlabel(label, fontsize=7, color=style.INK, loc="left")
        for first, name in zip(range(1, columns, 3), names, strict=True):
            pictures = _list_pictures(name, images, limits)
            shown = [
                style.show_picture(axes, picture, **look)
                for axes, (picture, look) in zip(row[first:], pictures, strict=False)
            ]
            for begin, end, text in _BARS[name]:
                bars[first + begin, first + end] = shown[begin], text
        for axes, title in zip(row, titles if number == 0 else (), strict=False):
            axes.set_title(title, fontsize=7, color=style.INK)
    for (first, last), (image, text) in bars.items():
        frame = figure.add_subplot(cells[rows, first:last])
        frame.set_axis_off()
        bar_axes = frame.inset_axes((0.05, 0.6, 0.9, 0.25))
        bar = figure.colorbar(image, cax=bar_axes, orientation="horizontal")
        bar.ax.tick_params(labelsize=7, colors=style.INK)
        bar.set_label(text, fontsize=7, color=style.INK)
    return style.save_figure(figure, path)


def _find_depths(every: Sequence[ViewImages]):
    """A scale from the smallest to the largest depth of what the true masks cover."""
    targets = [images.targets for images in every if "depth" in images.targets]
    found = [t["depth"][t["silhouette"] >= 0.5] for t in targets]
    values = np.concatenate([*found, np.zeros(0)])
    return Normalize(values.min(), values.max()) if values.size else Normalize(1.5, 2.5)


def _list_pictures(name: str, images: ViewImages, depths: Normalize):
    """Target, render and difference of a signal, each with how it is shown."""
    target, rendered = images.targets[name], images.rendered[name]
    away = rendered - target
    if name == "silhouette":
        return (target, {}), (rendered, {}), (away, {"cmap": "RdBu_r", "vmin": -1.0})
    if name == "color":
        away = np.sqrt(np.mean(away**2, axis=-1))
        target, rendered = (np.clip(image, 0.0, 1.0) for image in (target, rendered))
        return (target, {}), (rendered, {}), (away, {"vmax": 0.5})
    scales = depths, Normalize(-_DEPTH_DIFFERENCE, _DEPTH_DIFFERENCE)
    look, signed = (
        {"cmap": colormaps[colors].with_extremes(bad=_EMPTY), "norm": scale}
        for colors, scale in zip(("viridis_r", "RdBu_r"), scales, strict=True)
    )
    target, away = (
        np.ma.masked_where(images.targets["silhouette"] < 0.5, image)
        for image in (target, away)
    )
    rendered = np.ma.masked_where(images.rendered["silhouette"] < 0.5, rendered)
    return (target, look), (rendered, look), (away, signed)
