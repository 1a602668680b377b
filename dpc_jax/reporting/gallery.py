"""Pictures of predictions: input, silhouettes, and the cloud from two directions."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.spheres import REAR, draw_cloud
from dpc_jax.reporting.style import (
    INK,
    make_table_of_pictures,
    save_figure,
    spell_name,
)

_SHOWN_SURFACE_POINTS = 2000  # about as many as are predicted, to compare fairly


def draw_predictions(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid with one row per example.

    Columns: the input, the target silhouette, the predicted one, their difference (red
    where the prediction is too large, blue where it is too small), the predicted cloud
    from the front and from the rear, and the true shape from the front where an example
    has one. Clouds are orthographic, z up; near points are drawn over far ones and
    darker, or in their predicted colour, fading with distance.

    Raises:
      ValueError: there are no examples.
    """
    if not examples:
        raise ValueError(
            "examples must be at least one, but there are none; pass predictions."
        )
    titles = "input|target|predicted|difference|shape, front|shape, rear".split("|")
    if any(example.surface is not None for example in examples):
        titles.append("true shape")
    size = 1.45
    height = size * len(examples) * 1.12 + 0.35
    figure = make_table_of_pictures(size * len(titles) + 0.2, height)
    grid = figure.subplots(len(examples), len(titles), squeeze=False)
    for row, example in zip(grid, examples, strict=True):
        _draw_row(row, example)
    for axes, title in zip(grid[0], titles, strict=True):
        axes.set_title(title, fontsize=9, color=INK)
    return save_figure(figure, path)


def _draw_row(row, example: Example) -> None:
    for axes in row:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_color("#d5dbe1")
    row[0].imshow(example.image)
    row[1].imshow(example.target, cmap="gray", vmin=0.0, vmax=1.0)
    row[2].imshow(example.predicted, cmap="gray", vmin=0.0, vmax=1.0)
    difference = silhouette_difference(example.predicted, example.target)
    row[3].imshow(difference, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    row[4].imshow(draw_cloud(example.points, example.colors))
    row[5].imshow(draw_cloud(example.points, example.colors, view_deg=REAR))
    if len(row) > 6:
        if example.surface is None:
            row[6].set_axis_off()
        else:
            step = max(1, len(example.surface) // _SHOWN_SURFACE_POINTS)
            row[6].imshow(draw_cloud(example.surface[::step]))
    label = spell_name(example.name)
    if example.pose_error_deg is not None:
        label += f"   pose error {example.pose_error_deg:.1f}°"
    # However long it is, the layout keeps room for its height alone.
    row[0].set_xlabel(" ", fontsize=7.5)
    below = row[0].annotate(
        label,
        (0, 0),
        xycoords="axes fraction",
        xytext=(0, -3),
        textcoords="offset points",
        va="top",
        fontsize=7.5,
        color=INK,
    )
    below.set_in_layout(False)


def silhouette_difference(predicted: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Predicted minus target, the coarser one repeated onto the finer one's pixels."""
    rows, cols = np.maximum(predicted.shape, target.shape)
    stretched = []
    for image in (predicted, target):
        r = np.arange(rows) * image.shape[0] // rows
        c = np.arange(cols) * image.shape[1] // cols
        stretched.append(image[np.ix_(r, c)].astype(np.float64))
    return stretched[0] - stretched[1]
