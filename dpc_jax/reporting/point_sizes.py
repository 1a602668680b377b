"""Figures of appendix "Towards part-based models": hand-tuned and learned sizes."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpc_jax.reporting import style
from dpc_jax.reporting.ellipsoids import draw_ellipsoids

VIEW = (35.0, 20.0)  # azimuth, elevation in degrees: front and left, from above
LABELS = {
    "": "hand-tuned\nisotropic",
    "sigma": "learned\nisotropic",
    "covariance": "learned full\ncovariance",
}


@dataclass(frozen=True)
class Gaussians:
    """One predicted shape, and its silhouette beside the true one."""

    image: np.ndarray  # [S, S, 3] uint8, what the network saw
    target: np.ndarray  # [S, S] true silhouette, 0 to 1
    predicted: np.ndarray  # [D, D] rendered silhouette, 0 to 1
    points: np.ndarray  # [N, 3] object frame
    covariances: np.ndarray  # [N, 3, 3] object frame, in squares of its unit


def draw_silhouettes(
    shapes: Mapping[str, Sequence[Gaussians]], path: str | os.PathLike
) -> Path:
    """Silhouettes of each kind of size under the input and the target.

    Args:
      shapes: by kind of point size ("", "sigma" or "covariance"), of the same views.
    """
    kinds = [kind for kind in LABELS if kind in shapes]
    given = shapes[kinds[0]]
    rows = {"input": [s.image for s in given], "target": [s.target for s in given]}
    rows |= {LABELS[kind]: [s.predicted for s in shapes[kind]] for kind in kinds}
    return _draw_rows(rows, path)


def draw_gaussians(
    shapes: Mapping[str, Sequence[Gaussians]], path: str | os.PathLike
) -> Path:
    """Gaussians of each kind of size as shaded ellipsoids, under the input.

    A point has one colour in every column. Arguments as of `draw_silhouettes`.
    """
    kinds = [kind for kind in LABELS if kind in shapes]
    rows = {"input": [s.image for s in shapes[kinds[0]]]}
    for kind in kinds:
        rows[LABELS[kind]] = [
            draw_ellipsoids(
                shape.points,
                shape.covariances,
                _pick_colors(len(shape.points)),
                view_deg=VIEW,
            )
            for shape in shapes[kind]
        ]
    return _draw_rows(rows, path, size=2.3)


def _pick_colors(count):
    """Distinct colours of points: hues by the golden ratio."""
    hues = (np.arange(count) * 0.618034) % 1
    angles = 2 * np.pi * (hues[:, None] + np.array([0, 1 / 3, 2 / 3]))
    return np.clip(0.62 + 0.33 * np.cos(angles), 0, 1)


def _draw_rows(rows, path, *, size=1.7):
    width = max(len(images) for images in rows.values())
    figure = style.make_table_of_pictures(size * width + 1.0, size * len(rows) + 0.1)
    grid = figure.subplots(len(rows), width, squeeze=False)
    for line, (label, images) in zip(grid, rows.items(), strict=True):
        for axes, image in zip(line, images, strict=True):
            axes.imshow(image, cmap="gray", vmin=0.0, vmax=1.0)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_color("#d5dbe1")
        line[0].set_ylabel(label, fontsize=10, color=style.INK)
    return style.save_figure(figure, path)


def draw_projection_errors(
    errors: Mapping[str, Mapping[int, Sequence[float]]], path: str | os.PathLike
) -> Path:
    """Projection error over the number of points; a dot for each run, a line of means.

    Args:
      errors: by kind of point size, then number of points: the errors of its runs.
    """
    figure = style.make_figure(7.0, 4.2)
    axes = figure.subplots()
    colors = dict(zip(LABELS, style.SERIES, strict=False))
    counts = sorted({count for runs in errors.values() for count in runs})
    for kind, runs in errors.items():
        places = sorted(runs)
        means = [float(np.mean(runs[count])) for count in places]
        label = LABELS[kind].replace("\n", " ")
        axes.plot(places, means, "o-", color=colors[kind], label=label, lw=1.8)
        for count in places:
            dots = [count] * len(runs[count])
            axes.plot(dots, runs[count], ".", color=colors[kind], alpha=0.5)
    style.label_axes(
        axes,
        title="Projection error over the number of points",
        x_label="points",
        y_label="projection error per pixel",
        grid="both",
    )
    axes.set_xscale("log")
    style.set_ticks(axes, counts)
    found = [e for runs in errors.values() for same in runs.values() for e in same]
    axes.set_ylim(0.0, 1.1 * max(found))
    axes.legend(frameon=False, fontsize=9)
    return style.save_figure(figure, path)
