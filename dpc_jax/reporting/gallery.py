"""Pictures in a labelled grid, predictions as such a grid."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps

from dpc_jax.evaluation.images import resize
from dpc_jax.reporting import style
from dpc_jax.reporting.clouds import REAR, draw_cloud
from dpc_jax.reporting.examples import Example

_SHOWN_SURFACE_POINTS = 2000  # about as many as are predicted, to compare fairly
_FRAME = "#d5dbe1"


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
    difference = resize(example.predicted, side) - resize(example.target, side)
    colors = colormaps["RdBu_r"].with_extremes(bad="white")((difference + 1) / 2)
    return colors[..., :3]
