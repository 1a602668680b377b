"""Curves of many runs in one figure: a colour and a line style for each group."""

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dpc_jax.evaluation.metrics import get_metric
from dpc_jax.files import write_text
from dpc_jax.reporting import style
from dpc_jax.reporting.comparison.groups import ComparedRun, Group

# All of validation: the loss of training says nothing between settings.
PANELS = {  # with the text at the axis
    "pose_accuracy": "views within 30° (%)",
    "pose_median_error_deg": "degrees",
    "silhouette_iou": "of the images (%)",  # of sets without poses
    "chamfer": "mean distance × 100",
    "projection_error": "squares per pixel",
}
_DASHES = ("-", "--", ":", "-.")
_LEGEND_ROW = 0.2  # inches
_PANEL_WIDTH = 5.5


def draw_comparison(groups: Sequence[Group], path: Path) -> tuple[str, str]:
    """Draw error against run time; writes PATH.png and PATH.svg, panels in two columns.

    Returns:
      That figure as SVG, and the same with all panels below each other, for narrow
      pages. The lines of group i have ids that begin with "line-i-", those of its entry
      in the legend too.
    """
    figure = _draw(groups, columns=2)
    style.save_figure(figure, path)
    wide = _write_svg(figure, salt="wide")
    write_text(path.with_suffix(".svg"), wide)
    narrow = _write_svg(_draw(groups, columns=1), salt="narrow")
    return wide[wide.index("<svg") :], narrow[narrow.index("<svg") :]


def _draw(groups: Sequence[Group], *, columns: int) -> Figure:
    metrics = _choose_panels(groups)
    width = columns * _PANEL_WIDTH
    names = _count_columns(groups, width)
    height = 3.3 * -(-len(metrics) // columns) + _LEGEND_ROW * -(-len(groups) // names)
    figure = style.make_figure(width, height)
    panels = style.make_panels(figure, len(metrics), columns=columns)
    for axes, metric in zip(panels, metrics, strict=True):
        title, text = get_metric(metric).label, PANELS.get(metric, "loss")
        style.label_axes(axes, title=title, x_label="run time (min)", y_label=text)
        for index, group in enumerate(groups):
            for run in group.runs:
                _draw_run(axes, run, metric, index)
        _set_limits(axes, metric)
    handles = [_make_handle(index, group) for index, group in enumerate(groups)]
    legend = figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=names,
        frameon=False,
        fontsize=9,
        handlelength=3.2,
    )
    for index, line in enumerate(legend.get_lines()):
        line.set_gid(f"line-{index}-legend")
    return figure


def _write_svg(figure: Figure, *, salt: str) -> str:
    """The figure as SVG; what it refers to has ids of its own for each salt."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _choose_panels(groups: Sequence[Group]) -> list[str]:
    """What is recorded of these runs."""
    names = {n for g in groups for run in g.runs for line in run.records for n in line}
    return [name for name in PANELS if name in names] or ["loss"]


def _count_columns(groups: Sequence[Group], width: float) -> int:
    """Columns of the legend, as many as the longest name leaves room for in inches."""
    longest = max(len(group.name) for group in groups) + 8
    return min(len(groups), max(1, int(width / (0.075 * longest))))


def _look(index: int) -> dict:
    color = style.SERIES[index % len(style.SERIES)]
    return {
        "color": color,
        "ls": _DASHES[index // len(style.SERIES) % len(_DASHES)],
    }


def _make_handle(index: int, group: Group) -> Line2D:
    many = len(group.runs) > 1
    name = style.spell_name(group.name)
    label = f"{name} ({len(group.runs)} seeds)" if many else name
    return Line2D([], [], lw=2.0, label=label, **_look(index))


def _draw_run(axes: Axes, run: ComparedRun, metric: str, index: int) -> None:
    """The finite values of a run in order of time."""
    pairs = [(line.get("seconds"), line.get(metric)) for line in run.records]
    table = np.array(pairs, np.float64).reshape(-1, 2)  # None becomes NaN
    table = table[np.isfinite(table).all(axis=1)]
    if not table.size:
        return
    minutes, values = table[np.argsort(table[:, 0], kind="stable")].T
    (line,) = axes.plot(
        minutes / 60,
        get_metric(metric).factor * values,
        lw=1.3,
        marker="o",
        markevery=slice(len(values) - 1, None),
        ms=3.5,
        clip_on=False,  # the last point lies on the edge
        **_look(index),
    )
    line.set_gid(f"line-{index}-{metric}-{run.name}")


def _set_limits(axes: Axes, metric: str) -> None:
    latest = float(axes.dataLim.x1)
    axes.set_xlim(0.0, 1.02 * latest if latest > 0 else 1.0)
    if metric == "loss":
        axes.set_yscale("log")
    elif get_metric(metric).unit == "%":
        axes.set_ylim(0.0, 100.0)
    else:
        axes.set_ylim(0.0, 1.05 * max(float(axes.dataLim.y1), 1e-9))
