"""Figures of a run, drawn without a display.

Figures are made by hand (no pyplot), so nothing global changes and threads may draw.
"""

import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dpc_jax.files import write_bytes

INK, MUTED, GOOD, ACCENT = "#22303c", "#8795a1", "#2f7ebc", "#d1495b"
RUN_COLORS = ("#2f7ebc", "#d1495b", "#3a9d6e", "#e0a030", "#7b5ea7", "#5f6c77")
PANELS = (
    ("pose_accuracy", "Pose accuracy", "views within 30° (%)", 100.0),
    ("pose_median_error_deg", "Median pose error", "degrees", 1.0),
    ("chamfer", "Chamfer distance", "mean distance × 100", 1.0),
    ("loss", "Training loss", "loss (log scale)", 1.0),
)

Records = Sequence[Mapping[str, Any]]


def draw_curves(
    records: Records | Mapping[str, Records], path: str | os.PathLike
) -> Path:
    """Error against run time: pose accuracy, median error, Chamfer distance and loss.

    Args:
      records: lines of ``metrics.jsonl`` with ``seconds`` and any of ``pose_accuracy``,
        ``pose_median_error_deg``, ``chamfer`` and ``loss``; or a mapping from names to
        such lists, to compare runs. A line without a quantity is passed over, and so
        is a value that is not finite.
      path: of the PNG.
    """
    runs = records if isinstance(records, Mapping) else {"": records}
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    for axes, (key, title, unit, factor) in zip(
        figure.subplots(2, 2).flat, PANELS, strict=True
    ):
        drawn = False
        for index, (name, lines) in enumerate(runs.items()):
            seconds, values = _series(lines, key)
            if seconds.size == 0:
                continue
            drawn = True
            color = RUN_COLORS[index % len(RUN_COLORS)]
            if key == "loss":
                _draw_loss(axes, seconds, values, color, name)
            else:
                axes.plot(
                    seconds, factor * values, "o-", color=color, ms=3.5, label=name
                )
        _tidy(axes, title, "run time (s)", unit)
        if not drawn:
            place = {"transform": axes.transAxes, "ha": "center", "color": MUTED}
            axes.text(0.5, 0.5, "not recorded", **place)
            axes.set(xticks=[], yticks=[])
            continue
        axes.set_xlim(left=0.0)
        if key == "pose_accuracy":
            axes.set_ylim(0.0, 100.0)
        elif key != "loss":
            axes.set_ylim(bottom=0.0)
        if len(runs) > 1:
            axes.legend(frameon=False, fontsize=8)
    return save_figure(figure, path)


def draw_pose_errors(errors_deg: ArrayLike, path: str | os.PathLike) -> Path:
    """Histogram of pose errors from 0 to 180 degrees, with the 30° line and the median.

    Args:
      errors_deg: errors in degrees, any shape, at least one.
      path: of the PNG.

    Raises:
      ValueError: there are no errors, or one is not finite.
    """
    errors = np.asarray(errors_deg, np.float64).ravel()
    if errors.size == 0 or not np.isfinite(errors).all():
        raise ValueError(
            f"Expected finite pose errors in degrees, at least one, got {errors.size} "
            f"with {int((~np.isfinite(errors)).sum())} not finite; take them from the "
            f"evaluation."
        )
    figure = Figure(figsize=(7.5, 3.6), layout="constrained")
    axes = figure.subplots()
    _, edges, bars = axes.hist(errors, bins=36, range=(0.0, 180.0), rwidth=0.9)
    for left, bar in zip(edges, bars, strict=False):
        bar.set_color(GOOD if left < 30.0 else MUTED)
    share, median = 100 * np.mean(errors <= 30.0), np.median(errors)
    flips = 100 * np.mean(errors > 150.0)
    axes.axvline(30.0, color=INK, lw=1.2, label=f"30°: {share:.0f} % are within")
    axes.axvline(median, color=ACCENT, lw=1.6, ls="--", label=f"median: {median:.1f}°")
    axes.plot([], [], " ", label=f"beyond 150° (front as back): {flips:.0f} %")
    title = f"Pose errors of {errors.size} test views"
    _tidy(axes, title, "angle between predicted and true pose (degrees)", "views")
    axes.set(xlim=(0.0, 180.0), xticks=range(0, 181, 30))
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.legend(frameon=False, fontsize=9, loc="upper right")
    return save_figure(figure, path)


def draw_candidates(shares: ArrayLike, path: str | os.PathLike) -> Path:
    """Bars of the share of views that each pose candidate wins.

    Args:
      shares: [K] shares, 0 to 1.
      path: of the PNG.
    """
    percent = 100.0 * np.asarray(shares, np.float64).ravel()
    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes = figure.subplots()
    colors = [GOOD if value >= 1.0 else MUTED for value in percent]
    bars = axes.bar(np.arange(percent.size), percent, color=colors, width=0.75)
    if percent.size <= 16:  # labels of more bars would run into each other
        labels = [f"{value:.{int(0.0 < value < 1.0)}f}" for value in percent]
        axes.bar_label(bars, labels, fontsize=8, color=INK, padding=1)
    even = 100.0 / max(percent.size, 1)
    axes.axhline(even, color=ACCENT, lw=1.2, ls="--", label=f"even share: {even:.0f} %")
    alive = int(np.sum(percent >= 1.0))
    title = f"Winning pose candidates: {alive} of {percent.size} win at least 1 %"
    _tidy(axes, title, "candidate", "views won (%)")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_ylim(0.0, max(1.15 * percent.max(initial=0.0), 1.0))
    axes.legend(frameon=False, fontsize=9)
    return save_figure(figure, path)


def _series(lines: Records, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and values of the records that hold a finite value, in order of time."""
    pairs = [
        (line["seconds"], line[key])
        for line in lines
        if line.get(key) is not None and line.get("seconds") is not None
    ]
    table = np.array(pairs, dtype=np.float64).reshape(-1, 2)
    table = table[np.isfinite(table).all(axis=1)]
    return tuple(table[np.argsort(table[:, 0], kind="stable")].T)


def _draw_loss(axes, seconds, values, color, name) -> None:
    """The loss, faint where it is noisy, under its running mean."""
    window = max(1, values.size // 40)
    if window > 1:
        axes.plot(seconds, values, color=color, lw=0.6, alpha=0.35)
        kernel = np.full(window, 1.0 / window)
        values = np.convolve(values, kernel, mode="valid")
        seconds = np.convolve(seconds, kernel, mode="valid")
    axes.plot(seconds, values, color=color, lw=1.5, label=name)
    if np.all(values > 0.0):
        axes.set_yscale("log")


def _tidy(axes, title: str, x_label: str, y_label: str) -> None:
    axes.set_title(title, loc="left", fontsize=11, color=INK, fontweight="bold")
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.tick_params(labelsize=8, colors=INK, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#e6eaee", lw=0.8)
    axes.set_axisbelow(True)


def save_figure(figure: Figure, path: str | os.PathLike, *, dpi: int = 130) -> Path:
    """Write the figure as PNG, whole or not at all."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    # Without the library's version in it, the same data give the same bytes.
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return write_bytes(path, buffer.getvalue())
