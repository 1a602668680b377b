"""Figures of a run: curves over run time, pose errors over azimuth."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dpc_jax.evaluation.metrics import get_metric
from dpc_jax.evaluation.pose import ACCURACY_THRESHOLD_DEG, KINDS, Failures, count_alive
from dpc_jax.reporting import style

# Metrics drawn over run time.
_CURVES = (
    "pose_accuracy",
    "pose_median_error_deg",
    "chamfer",
    "silhouette_iou",
    "stray_points",
    "candidates_alive",
    "loss",
)

Records = Sequence[Mapping[str, Any]]


def find_curve(records: Records, metric: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and values, in the metric's unit, where both are finite, by time."""
    pairs = [(line.get("seconds"), line.get(metric)) for line in records]
    table = np.array(pairs, dtype=np.float64).reshape(-1, 2)  # None becomes NaN
    table = table[np.isfinite(table).all(axis=1)]
    seconds, values = table[np.argsort(table[:, 0], kind="stable")].T
    return seconds, get_metric(metric).factor * values


def draw_panels(
    figure: Figure,
    metrics: Sequence[str],
    draw: Callable[[Axes, str], None],
    *,
    unit: str,
) -> None:
    """A panel for each metric over one span of run time, filled by `draw`.

    They are in rows of two; a single one takes the whole figure. Shares are shown
    whole, all but the loss from zero.
    """
    columns = min(2, len(metrics))
    grid = figure.subplots(-(-len(metrics) // columns), columns, squeeze=False)
    panels = grid.flat[: len(metrics)]
    for axes in grid.flat[len(metrics) :]:
        axes.set_visible(False)
    for axes, metric in zip(panels, metrics, strict=True):
        title = get_metric(metric).heading
        style.label_axes(axes, title=title, x_label=f"run time ({unit})")
        draw(axes, metric)
        if get_metric(metric).unit == "%":
            axes.set_ylim(0.0, 100.0)
        elif metric != "loss":
            axes.set_ylim(0.0, 1.08 * max(axes.dataLim.y1, 1e-9))
        elif 0.0 < axes.dataLim.y0 < np.inf:
            axes.set_yscale("log")
    latest = max(float(axes.dataLim.x1) for axes in panels)
    for axes in panels:
        axes.set_xlim(0.0, 1.02 * latest if latest > 0 else 1.0)


def draw_curves(records: Records, path: str | os.PathLike) -> Path:
    """What a run records over its run time, a panel for each measure that is recorded.

    Poses, shapes and the overlap of silhouettes are of validation, at one size of the
    points and one grid; how many pose candidates are alive and the loss are of
    training, where both change over a run.

    Args:
      records: lines of `metrics.jsonl` with `seconds`. Values that are missing or not
        finite are not drawn.
    """
    lines = [
        line | {"candidates_alive": count_alive(line["head_shares"])}
        if line.get("head_shares") is not None
        else line
        for line in map(dict, records)
    ]
    found = {metric: find_curve(lines, metric) for metric in _CURVES}
    shown = [m for m, (seconds, _) in found.items() if seconds.size] or ["loss"]
    figure = style.make_figure(9.0, 3.0 * -(-len(shown) // 2))

    def draw(axes, metric):
        _draw_curve(axes, metric, *found[metric])

    draw_panels(figure, shown, draw, unit="s")
    return style.save_figure(figure, path)


def _draw_curve(axes: Axes, metric: str, seconds: np.ndarray, values: np.ndarray):
    if metric == "loss":  # faint where it is noisy, under its running mean
        window = max(1, values.size // 40)
        if window > 1:
            axes.plot(seconds, values, color=style.BLUE, lw=0.6, alpha=0.35)
            kernel = np.full(window, 1.0 / window)
            values = np.convolve(values, kernel, mode="valid")
            seconds = np.convolve(seconds, kernel, mode="valid")
        axes.plot(seconds, values, color=style.BLUE, lw=1.5)
    elif metric == "candidates_alive":
        axes.step(seconds, values, where="post", color=style.BLUE, lw=1.5)
        axes.yaxis.set_major_locator(MaxNLocator("auto", integer=True))
    else:
        look = {"color": style.BLUE, "ms": 3.5, "clip_on": False, "zorder": 3}
        axes.plot(seconds, values, "o-", **look)


def draw_fit(records: Records, path: str | os.PathLike) -> Path:
    """Loss of a fit over run time, a line for each side of the images.

    The records have seconds, side and loss per pixel (`Fit.curve`).
    """
    figure = style.make_figure(5.0, 3.2)
    axes = figure.subplots()
    title = "Difference of silhouettes"
    style.label_axes(axes, title=title, x_label="run time (s)", y_label="per pixel")
    for index, side in enumerate(dict.fromkeys(line["side"] for line in records)):
        seconds, values = find_curve([r for r in records if r["side"] == side], "loss")
        color = style.SERIES[index % len(style.SERIES)]
        axes.plot(seconds, values, color=color, label=f"{side}² pixels")
    axes.set_yscale("log")
    axes.set_xlim(left=0.0)
    axes.legend(frameon=False, fontsize=8)
    return style.save_figure(figure, path)


# Colour and sign of right views and of each kind of wrong ones (`pose.KINDS`).
_LOOKS = {
    -1: ("right", style.BLUE, "o"),
    0: (KINDS[0], style.RED, "s"),
    1: (KINDS[1], style.AMBER, "^"),
    2: (KINDS[2], style.GREEN, "D"),
    3: ("wrong otherwise", style.MUTED, "X"),
}


def draw_azimuths(views: Failures, path: str | os.PathLike) -> Path:
    """Pose error of each view over its true azimuth."""
    figure = style.make_figure(7.5, 4.2)
    axes = figure.subplots()
    for kind, (label, color, marker) in _LOOKS.items():
        rows = views.kinds == kind
        if rows.any():
            label = f"{label}: {int(rows.sum())}"
            look = {"s": 14, "color": color, "marker": marker, "linewidths": 0}
            look |= {"alpha": 0.75, "clip_on": False, "zorder": 3, "label": label}
            axes.scatter(views.azimuths_deg[rows], views.errors_deg[rows], **look)
    axes.axhline(ACCURACY_THRESHOLD_DEG, color=style.INK, lw=1.0)
    x_label = "true azimuth (degrees; 0 front, 90 left, 180 rear)"
    style.label_axes(axes, title="Pose error", x_label=x_label, y_label="degrees")
    axes.set(xlim=(0, 360), xticks=range(0, 361, 90), ylim=(0, 180))
    axes.set_yticks(range(0, 181, 30))
    style.add_legend(figure, ncols=len(_LOOKS))
    return style.save_figure(figure, path)
