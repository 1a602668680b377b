"""The page of a comparison: one table, and one figure of all curves."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dpc_jax.evaluation.metrics import get_metric
from dpc_jax.files import write_text
from dpc_jax.reporting import style
from dpc_jax.reporting.figures import draw_panels, find_curve
from dpc_jax.reporting.groups import ComparedRun, Group, find_common
from dpc_jax.reporting.tables import format_table, make_table
from dpc_jax.reporting.web.markup import assemble_page, embed_chart, read_asset

# Columns of the table; one without any number is left out.
COLUMNS = (
    "pose_accuracy",
    "pose_median_error_deg",
    "best_candidate_pose_accuracy",
    "chamfer",
    "precision",
    "coverage",
    "silhouette_iou",
    "train_seconds",
    "peak_memory_gb",
)
# All of validation: the loss of training says nothing between settings.
PANELS = (
    "pose_accuracy",
    "pose_median_error_deg",
    "silhouette_iou",  # of sets without poses
    "chamfer",
    "projection_error",
)
_LEGEND_ROW = 0.2  # inches
_TABLE = (
    "Figures of the test split. Runs that differ in the seed alone stand together, "
    "under their mean ± standard deviation (n − 1). Marked: settings that most others "
    "have otherwise."
)
_HOW_TO_READ = (
    "Validation during training, over wall clock. The runs of a group have one colour."
)


def write_comparison(folder: Path, groups: Sequence[Group]) -> Path:
    """Write index.html and curves.svg into a folder; the path of the page."""
    title = "Error against run time"
    path = draw_comparison(groups, folder / "curves.svg")
    curves = f"<h2>{title}</h2><p>{_HOW_TO_READ}</p>\n"
    curves += embed_chart(path, title, is_photo=False)
    count = sum(len(group.runs) for group in groups)
    title = f"{count} runs side by side" if count > 1 else "One run"
    common = find_common([group.runs[0].fields for group in groups])
    summary = "<summary>The settings where nothing is marked</summary>"
    body = (
        f"<h1>{title}</h1>\n<p>{_TABLE}</p>\n"
        f"{_show_table(groups)}"
        + (f"<details>{summary}{_mark(common)}</details>\n" if common else "")
        + curves
    )
    page = assemble_page(title, body, style=read_asset("comparison.css"))
    return write_text(folder / "index.html", page)


def tabulate_groups(groups: Sequence[Group]) -> str:
    """The table as Markdown, without the settings, for a terminal."""
    heads, rows = _tabulate(groups)
    return format_table(heads, [cells for _, _, cells in rows])


def _tabulate(groups: Sequence[Group]):
    """Heads, and rows: of a group or one of its runs, what differs, cells of text."""
    columns = [n for n in COLUMNS if any(g.summarize(n) is not None for g in groups)]
    columns = columns or ["train_seconds"]
    rows: list[tuple[str, Mapping[str, Any], list[str]]] = []
    for group in groups:
        count = len(group.runs)
        name = f"{group.name}, {count} seeds" if count > 1 else _name(group.runs[0])
        cells = [name, *map(group.describe, columns)]
        rows.append(("group", group.differs, cells))
        for run in group.runs if count > 1 else ():
            alone = Group(run.name, (run,))
            rows.append(("run", {}, [_name(run), *map(alone.describe, columns)]))
    return ["Run", *(get_metric(name).heading for name in columns)], rows


def _name(run: ComparedRun) -> str:
    return run.name + (f" ({run.unfinished})" if run.unfinished else "")


def _show_table(groups: Sequence[Group]) -> str:
    heads, rows = _tabulate(groups)
    shown = []
    for kind, differs, (name, *cells) in rows:
        first = f'<div class="{kind}">{html.escape(name)}</div>'
        shown.append([first + _mark(differs), *map(html.escape, cells)])
    return make_table(shown, map(html.escape, heads), kind="numbers")


def _mark(settings: Mapping[str, object]) -> str:
    texts = (
        f"{name} {value if isinstance(value, str) and value else repr(value)}"
        for name, value in settings.items()
    )
    return "".join(f"<mark>{html.escape(text)}</mark>" for text in texts)


def draw_comparison(groups: Sequence[Group], path: Path) -> Path:
    """Draw error against run time, a colour and line style for each group.

    Of `PANELS` those are drawn that are recorded; where none is, the loss.
    """
    recorded = {
        n for g in groups for run in g.runs for line in run.records for n in line
    }
    metrics = [name for name in PANELS if name in recorded] or ["loss"]
    width, rows = 11.0, -(-len(metrics) // 2)
    longest = max(len(group.name) for group in groups) + 8
    names = min(len(groups), max(1, int(width / (0.075 * longest))))  # in a row
    height = 3.3 * rows + _LEGEND_ROW * -(-len(groups) // names)
    figure = style.make_figure(width, height)

    def draw(axes, metric):
        for index, group in enumerate(groups):
            for run in group.runs:
                _draw_run(axes, run, metric, index)

    draw_panels(figure, metrics, draw, unit="min")
    handles = []
    for index, group in enumerate(groups):
        seeds = f" ({len(group.runs)} seeds)" if len(group.runs) > 1 else ""
        label = style.spell_name(group.name) + seeds
        look: dict[str, Any] = style.pick_series(index) | {"marker": ""}
        handles.append(Line2D([], [], lw=2.0, label=label, **look))
    style.add_legend(figure, handles=handles, ncols=names, handlelength=3.2)
    return style.save_figure(figure, path)


def _draw_run(axes: Axes, run: ComparedRun, metric: str, index: int) -> None:
    seconds, values = find_curve(run.records, metric)
    look: dict[str, Any] = style.pick_series(index) | {"marker": "o"}
    look |= {"markevery": slice(len(values) - 1, None), "ms": 3.5}
    # The last point lies on the edge.
    axes.plot(seconds / 60, values, lw=1.3, clip_on=False, **look)
