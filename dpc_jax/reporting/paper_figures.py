"""Figures of the paper's experiments: correspondences, interpolation, point sizes."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from dpc_jax.reporting import style
from dpc_jax.reporting.clouds import FRONT, draw_cloud, draw_ellipsoids, shade_depth
from dpc_jax.reporting.gallery import draw_grid

_COLUMNS = 6  # as in the paper
_PLAIN, _MARKED = 0.010, 0.021  # radii of the spheres, object units
_COLORS = (
    "#e6194b", "#3cb44b", "#ffb000", "#4363d8", "#f06a1d", "#911eb4",
    "#1fb8c4", "#f032e6", "#8db600", "#7a4a1e", "#008080", "#000075",
)  # fmt: skip
_STRIP = 256  # pixels of a cloud in a strip
_INSET = 80  # of an input in the corner of a cloud


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
      templates: how many of the first clouds are templates, which are named.
    """
    pictures: list[np.ndarray | None] = []
    for image, cloud in zip(images, clouds, strict=True):
        colors = 0.35 * shade_depth(cloud, FRONT) + 0.65 * np.array([0.80, 0.82, 0.85])
        radius = np.full(len(cloud), _PLAIN)
        for i, index in enumerate(found):
            colors[index], radius[index] = to_rgb(_COLORS[i % len(_COLORS)]), _MARKED
        picture = draw_cloud(cloud, colors, radius=radius)
        size = _INSET, _INSET
        small = Image.fromarray(image).resize(size, Image.Resampling.BICUBIC)
        corner = picture[:_INSET, :_INSET]
        corner[:] = np.minimum(corner, np.array(small))
        pictures.append(picture)
    pictures += [None] * (-len(pictures) % _COLUMNS)
    rows = [pictures[i : i + _COLUMNS] for i in range(0, len(pictures), _COLUMNS)]
    return draw_grid(rows, path, titles=["template"] * templates)


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


# Kinds of point sizes, with their labels.
LABELS = {
    "": "hand-tuned isotropic",
    "sigma": "learned isotropic",
    "covariance": "learned full covariance",
}


@dataclass(frozen=True)
class Gaussians:
    """One predicted shape, and its silhouette beside the true one."""

    image: np.ndarray  # [S, S, 3] uint8, what the network saw
    target: np.ndarray  # [S, S] true silhouette, 0 to 1
    predicted: np.ndarray  # [D, D] rendered silhouette, 0 to 1
    points: np.ndarray  # [N, 3] object frame
    covariances: np.ndarray  # [N, 3, 3] object frame, in squares of its unit


def draw_gaussians(
    shapes: Mapping[str, Sequence[Gaussians]], path: str | os.PathLike
) -> Path:
    """Silhouettes and Gaussians of each kind of size, under the input and the target.

    Gaussians are shaded ellipsoids; a point has one colour in every column.

    Args:
      shapes: by kind of point size ("", "sigma" or "covariance"), of the same views.
    """
    given = next(iter(shapes.values()))
    rows = {"input": [s.image for s in given], "target": [s.target for s in given]}
    for kind in [kind for kind in LABELS if kind in shapes]:
        rows[LABELS[kind]] = [shape.predicted for shape in shapes[kind]]
        rows[f"{LABELS[kind]}, Gaussians"] = [
            draw_ellipsoids(
                shape.points,
                shape.covariances,
                _pick_colors(len(shape.points)),
                view_deg=FRONT,
            )
            for shape in shapes[kind]
        ]
    return draw_grid(list(rows.values()), path, labels=list(rows), size=2.3)


def _pick_colors(count):
    """Distinct colours of points: hues by the golden ratio."""
    hues = (np.arange(count) * 0.618034) % 1
    angles = 2 * np.pi * (hues[:, None] + np.array([0, 1 / 3, 2 / 3]))
    return np.clip(0.62 + 0.33 * np.cos(angles), 0, 1)


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
    for kind, runs in errors.items():
        places = sorted(runs)
        means = [float(np.mean(runs[count])) for count in places]
        axes.plot(places, means, "o-", color=colors[kind], label=LABELS[kind], lw=1.8)
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
    counts = sorted({count for runs in errors.values() for count in runs})
    axes.set_xticks(counts, [f"{count:g}" for count in counts])
    axes.set_xticks([], minor=True)
    axes.set_ylim(0.0, 1.1 * axes.dataLim.y1)
    axes.legend(frameon=False, fontsize=9)
    return style.save_figure(figure, path)
