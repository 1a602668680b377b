"""Pictures in a labelled grid; predictions and rendered images as such grids."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy.typing import ArrayLike

from dpc_jax.evaluation.images import ViewImages, resize
from dpc_jax.reporting import style
from dpc_jax.reporting.clouds import REAR, draw_cloud
from dpc_jax.reporting.examples import Example

_SHOWN_SURFACE_POINTS = 2000  # about as many as are predicted, to compare fairly
_FRAME = "#d5dbe1"
_EMPTY = (0.93, 0.945, 0.957)  # the background of depths, pale grey
_SIGNED = Normalize(-1.0, 1.0)
_DEPTH_DIFFERENCE = 0.25  # box diagonals at the ends of the scale


def draw_grid(
    rows: Sequence[Sequence[np.ndarray | None]],
    path: str | os.PathLike,
    *,
    titles: Sequence[str] = (),
    labels: Sequence[str] = (),
    size: float = 1.9,
) -> Path:
    """Write pictures as a grid; None leaves a place empty.

    Args:
      rows: of pictures [S, S] of 0 to 1, or [S, S, 3]; some, all of one length.
      titles: of the columns. labels: of the rows, below the first picture.
      size: of a picture, inches.
    """
    height = size * len(rows) * (1.12 if labels else 1.02) + (0.3 if titles else 0.05)
    figure = style.make_figure(size * len(rows[0]), height)
    gaps = dict.fromkeys(("w_pad", "h_pad", "wspace", "hspace"), 0.02)
    top = 1 - 0.06 / height  # what is above a title, or its letters are cut
    figure.set_layout_engine("constrained", **gaps, rect=(0, 0, 1, top))
    grid = figure.subplots(len(rows), len(rows[0]), squeeze=False)
    for axes, picture in zip(grid.flat, (p for row in rows for p in row), strict=True):
        if picture is None:
            axes.set_axis_off()
        else:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_color(_FRAME)
            axes.imshow(picture, cmap="gray", vmin=0.0, vmax=1.0)
    for axes, title in zip(grid[0], titles, strict=False):
        axes.set_title(title, fontsize=9, color=style.INK)
    for axes, label in zip(grid[:, 0], labels, strict=False):
        # However long it is, the layout keeps room for its height alone.
        axes.set_xlabel(" ", fontsize=7.5)
        text = {"va": "top", "fontsize": 7.5, "color": style.INK}
        axes.text(0, -0.03, label, transform=axes.transAxes, **text).set_in_layout(
            False
        )
    return style.save_figure(figure, path)


def draw_predictions(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid with one row per example.

    Columns: the input, the target silhouette, the predicted one, their difference (red
    where the prediction is too large, blue where it is too small), the predicted cloud
    from the front and from the rear, and from the front the true shape and its
    neighbours, where examples have them. Clouds are orthographic, z up; near points are
    drawn over far ones and darker, or in their predicted colour, fading with distance.
    Below each row stands what is measured of it.
    """
    titles = "input|target|predicted|difference|shape, front|shape, rear".split("|")
    if any(example.surface is not None for example in examples):
        titles.append("true shape")
    titles += [near.title for near in examples[0].neighbours]
    rows, labels = [], []
    for example in examples:
        cloud = example.points, example.colors
        row: list[np.ndarray | None] = [
            example.image,
            example.target,
            example.predicted,
            draw_difference(example),
        ]
        row += [draw_cloud(*cloud), draw_cloud(*cloud, view_deg=REAR)]
        if example.surface is not None:
            step = max(1, len(example.surface) // _SHOWN_SURFACE_POINTS)
            row.append(draw_cloud(example.surface[::step]))
        row += [draw_cloud(near.points) for near in example.neighbours]
        rows.append(row + [None] * (len(titles) - len(row)))
        labels.append(
            "   ".join([style.spell_name(example.title), *example.list_measures()])
        )
    return draw_grid(rows, path, titles=titles, labels=labels, size=1.45)


def draw_difference(example: Example) -> np.ndarray:
    """Of the silhouettes, [S, S, 3] of 0 to 1: red too large, blue too small."""
    side = max(len(example.predicted), len(example.target))
    away = resize(example.predicted, side) - resize(example.target, side)
    return _paint("RdBu_r", _SIGNED(away))


def draw_signals(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid of images, a row per example, after its input three for each signal.

    These are the target, the render from the predicted pose, and their difference. Of
    silhouettes and depths it is signed: red where the render is too large or too far,
    blue where it is too small or too near. Depths are on one scale for all rows, the
    near ones bright; the background is grey. The difference of colours is their
    distance, black for none.

    Args:
      examples: at least one, all with images of the same signals.
    """
    every = [example.images for example in examples if example.images]
    depths, titles = _find_depths(every), ["input"]
    for name in every[0].rendered:
        titles += [name, "rendered", "difference"]
    rows = [[example.image] for example in examples]
    for row, images in zip(rows, every, strict=True):
        for name in images.rendered:
            row += _list_pictures(name, images, depths)
    labels = [style.spell_name(example.name) for example in examples]
    return draw_grid(rows, path, titles=titles, labels=labels, size=1.2)


def _find_depths(every: Sequence[ViewImages]):
    """A scale from the smallest to the largest depth of what the true masks cover."""
    targets = [images.targets for images in every if "depth" in images.targets]
    found = [t["depth"][t["silhouette"] >= 0.5] for t in targets]
    values = np.concatenate([*found, np.zeros(0)])
    return Normalize(values.min(), values.max()) if values.size else Normalize(1.5, 2.5)


def _list_pictures(name: str, images: ViewImages, depths: Normalize):
    """Target, render and difference of a signal."""
    target, rendered = images.targets[name], images.rendered[name]
    away = rendered - target
    if name == "silhouette":
        return target, rendered, _paint("RdBu_r", _SIGNED(away))
    if name == "color":
        distance = np.sqrt(np.mean(away**2, axis=-1))
        return np.clip(target, 0, 1), np.clip(rendered, 0, 1), 2 * distance
    outside, missed = (
        one["silhouette"] < 0.5 for one in (images.targets, images.rendered)
    )
    signed = _SIGNED(away / _DEPTH_DIFFERENCE)
    return (
        _paint("viridis_r", depths(target), outside),
        _paint("viridis_r", depths(rendered), missed),
        _paint("RdBu_r", signed, outside),
    )


def _paint(colors: str, shares, is_empty: ArrayLike = False) -> np.ndarray:
    """Shares of a scale of colours [S, S] as [S, S, 3]."""
    painted = colormaps[colors].with_extremes(bad="white")(shares)[..., :3]
    return np.where(np.expand_dims(is_empty, -1), _EMPTY, painted)
