"""Figures of the page: a measure against resolution, against points, over run time."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dpc_jax.evaluation.metrics import get_metric
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.published import MEAN
from dpc_jax.experiments.results import Results
from dpc_jax.experiments.runs import find_resolution
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.reporting import style

Caption = str
Drawn = tuple[Path, Caption]


def draw_figures(results: Results, experiment: Experiment, folder: Path) -> list[Drawn]:
    """The figures that an experiment's runs allow, with their captions."""
    drawn = []
    for name, draw in (
        ("known_pose", _draw_resolutions),
        ("ablation", _draw_point_counts),
        ("ablation", _draw_bars),
    ):
        if experiment.name == name:
            figure = draw(results, experiment, folder)
            drawn += [figure] if figure else []
    if experiment.name in ("known_pose", "unknown_pose", "color", "depth"):
        drawn += _draw_run_times(results, experiment, folder)
    return drawn


def _list_series(results, experiment, rows, category, metric="chamfer"):
    """(position, mean, spread, paper's number) of the rows that have any."""
    for row, position in rows:
        summary = results.summarize(experiment, row, category, metric)
        mean = summary.mean if summary else math.nan
        spread = (summary.spread or 0.0) if summary else 0.0
        paper = results.find_published(experiment, row, category, metric)
        yield position, mean, spread, math.nan if paper is None else paper


def _draw_lines(results, experiment, rows, x_label, path) -> Path | None:
    """Ours and the paper's against a number, a panel per category."""
    categories = results.list_categories(experiment)
    names = [*categories, MEAN] if len(categories) > 1 else categories
    series = {c: list(_list_series(results, experiment, rows, c)) for c in names}
    if all(math.isnan(mean) for points in series.values() for _, mean, *_ in points):
        return None
    figure = style.make_figure(3.2 * len(names) + 0.6, 3.2)
    panels = style.make_panels(figure, len(names), columns=len(names))
    for axes, (category, points) in zip(panels, series.items(), strict=True):
        places, means, spreads, paper = zip(*points, strict=True)
        _plot(axes, places, means, spreads, paper)
        style.label_axes(
            axes, title=category, x_label=x_label, y_label=get_metric("chamfer").heading
        )
        axes.set_xscale("log")
        style.set_ticks(axes, places)
        axes.set_ylim(bottom=0.0)
    panels[0].legend(frameon=False, fontsize=8)
    return style.save_figure(figure, path)


def _plot(axes: Axes, places, means, spreads, paper):
    label = "ours"
    axes.errorbar(places, means, spreads, fmt="o-", color=style.BLUE, label=label)
    axes.plot(places, paper, "s--", color=style.MUTED, ms=4, label="paper (ShapeNet)")


def _draw_resolutions(results, experiment, folder) -> Drawn | None:
    rows = [
        (row, int(find_resolution(row)))
        for row in experiment.rows
        if row.published.startswith("Ours, ")
    ]
    path = folder / "known_pose_resolution.png"
    drawn = _draw_lines(results, experiment, rows, "side of images (pixels)", path)
    caption = "Chamfer distance against the resolution of the silhouettes."
    return (drawn, caption) if drawn else None


def _draw_point_counts(results, experiment, folder) -> Drawn | None:
    rows = [
        (row, int(row.label.split()[-2]))
        for row in experiment.rows
        if row.label.endswith("points")
    ]
    rows.sort(key=lambda pair: pair[1])
    path = folder / "ablation_points.png"
    drawn = _draw_lines(results, experiment, rows, "points of a cloud", path)
    return (drawn, "Chamfer distance against the number of points.") if drawn else None


def _draw_bars(results, experiment, folder) -> Drawn | None:
    """Precision and coverage of every row, stacked to the Chamfer distance."""
    (category,) = results.list_categories(experiment) or [""]
    found = [
        (row, [_read(results, experiment, row, category, m) for m in _PARTS])
        for row in experiment.rows
    ]
    if all(math.isnan(value) for _, values in found for value in values):
        return None
    figure = style.make_figure(7.5, 4.2)
    axes = figure.subplots()
    for i, (row, values) in enumerate(found):
        total = results.summarize(experiment, row, category, "chamfer")
        spread = total.spread if total else None
        paper = [
            experiment.table.find(row.published, category, m) or 0.0 for m in _PARTS
        ]
        for shift, parts, error, (_, colors) in (
            (-0.2, values, spread, _SIDES[0]),
            (0.2, paper, None, _SIDES[1]),
        ):
            axes.barh(i + shift, parts[0], 0.36, color=colors[0])
            bars = {"left": parts[0], "color": colors[1], "ecolor": style.INK}
            axes.barh(i + shift, parts[1], 0.36, xerr=error, **bars)
    axes.set_yticks(range(len(found)), [row.label for row, _ in found])
    axes.invert_yaxis()
    heading = get_metric("chamfer").heading
    style.label_axes(axes, title=category, x_label=heading, grid="x")
    keys = [
        Patch(color=color, label=f"{part}, {side}")
        for side, colors in _SIDES
        for part, color in zip(_PARTS, colors, strict=True)
    ]
    figure.legend(
        handles=keys, loc="outside lower center", ncols=4, frameon=False, fontsize=8
    )
    path = style.save_figure(figure, folder / "ablation.png")
    caption = (
        "Precision plus coverage of every row, whose sum is the Chamfer distance; "
        "whiskers are its standard deviation over seeds."
    )
    return path, caption


_PARTS = ("precision", "coverage")
_SIDES = (
    ("ours", (style.BLUE, style.SERIES[6])),
    ("paper (ShapeNet)", (style.MUTED, "#c9d1d8")),
)


def _read(results, experiment, row: Row, category, metric):
    summary = results.summarize(experiment, row, category, metric)
    return summary.mean if summary else math.nan


def _draw_run_times(results, experiment, folder) -> list[Drawn]:
    """Validation over training time, a figure per category and a line per row."""
    metrics = [m for m in ("pose_accuracy", "chamfer") if m in experiment.metrics]
    drawn = []
    for category in results.list_categories(experiment):
        lines = list(_list_records(results, experiment, category))
        if not lines:
            continue
        known = [m for m in metrics if _has_metric(lines, m)] or metrics[-1:]
        figure = style.make_figure(4.4 * len(known) + 2.4, 3.4)
        panels = style.make_panels(figure, len(known), columns=len(known))
        keys = {}
        for axes, metric in zip(panels, known, strict=True):
            keys |= _plot_records(axes, lines, metric)
        _scale_minutes(panels)
        shown = [keys[i] for i in sorted(keys)]
        figure.legend(
            handles=shown, loc="outside right center", frameon=False, fontsize=8
        )
        path = folder / f"{experiment.name}_{category}_time.png"
        caption = (
            f"{category}: validation over minutes of training, first seed of each row."
        )
        drawn.append((style.save_figure(figure, path), caption))
    return drawn


def _list_records(results, experiment, category):
    """(label, records) of the first finished run of every row."""
    for row in experiment.rows:
        for outcome in results.list_outcomes(experiment, row, category):
            if outcome.metrics is not None:
                log = MetricLog(outcome.workdir / "metrics.jsonl")
                yield row.label, log.read()
                break


def _has_metric(lines: Sequence, metric: str) -> bool:
    """Whether any row has it: with known poses none has figures of them."""
    return any(r.get(metric) is not None for _, records in lines for r in records)


def _plot_records(axes: Axes, lines: Sequence, metric: str) -> dict[int, Line2D]:
    """Draw the lines that have the metric; these by their number."""
    known = get_metric(metric)
    drawn = {}
    for i, (label, records) in enumerate(lines):
        points = [
            (r["seconds"] / 60, known.factor * r[metric])
            for r in records
            if r.get(metric) is not None and r.get("seconds")
        ]
        if points:
            looks = {"ms": 3, "label": label, **style.pick_series(i)}
            (drawn[i],) = axes.plot(*zip(*points, strict=True), **looks)
    style.label_axes(
        axes, title=known.label, x_label="minutes of training", y_label=known.heading
    )
    axes.set_ylim(0.0, 100.0 if known.unit == "%" else None)
    return drawn


def _scale_minutes(panels: Sequence[Axes]) -> None:
    """From 0 on, but logarithmic where short runs would be a corner of a panel."""
    lines = [line for axes in panels for line in axes.lines]
    times = [np.asarray(line.get_xdata(), np.float64) for line in lines]
    ends = [time.max() for time in times]
    is_wide = bool(ends) and max(ends) > 5 * min(ends)
    for axes in panels:
        if not is_wide:
            axes.set_xlim(left=0.0)
            continue
        axes.set_xscale("log")
        first, last = min(time.min() for time in times), max(ends)
        axes.set_xlim(first / 1.2, last * 1.2)
        ticks = [step * 10.0**power for power in range(-2, 5) for step in (1, 2, 5)]
        style.set_ticks(axes, [tick for tick in ticks if first <= tick <= last])
