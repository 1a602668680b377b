"""The page of a comparison: one table, and one figure of all curves."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from dpc_jax.evaluation.metrics import MISSING, format_metric
from dpc_jax.files import write_text
from dpc_jax.reporting.comparison.curves import draw_comparison
from dpc_jax.reporting.comparison.groups import (
    ComparedRun,
    Group,
    find_best,
    find_common,
)
from dpc_jax.reporting.tables import format_table
from dpc_jax.reporting.web.markup import assemble_page

# Metric: the head of its column. A column without any number is left out.
COLUMNS = {
    "pose_accuracy": "Pose accuracy (%)",
    "pose_median_error_deg": "Median error (°)",
    "best_candidate_pose_accuracy": "Best candidate (%)",
    "chamfer": "Chamfer ×100",
    "precision": "Precision ×100",
    "coverage": "Coverage ×100",
    "silhouette_iou": "Overlap (%)",
    "train_seconds": "Training (min)",
    "peak_memory_gb": "Memory (GB)",
}
_HOW_TO_READ = (
    "Validation during training, over wall clock. The runs of a group have one colour. "
    "Point at a row of the table to see its curves alone, click to keep them."
)
# Beside what all pages have in common.
_STYLE = """
:root{--mark:#fff0c9;--best:#2c7a54;--over:#eaf2f9}
@media (prefers-color-scheme:dark){:root{--mark:#4a3d17;--best:#6fd3a0;--over:#26313a}
svg{filter:invert(.89) hue-rotate(180deg)}}
.curves svg{display:block;width:100%;height:auto}
.narrow{display:none}
@media (max-width:46rem){.roomy{display:none}.narrow{display:block}}
td,th{vertical-align:top;white-space:nowrap}th{vertical-align:bottom;white-space:normal}
tr.group td{font-weight:600;padding-top:.7rem}
tr.group:has(+tr.settings) td{border:0}tr.settings td{padding-top:0;text-align:left}
tr.run td{color:var(--soft);font-size:.82rem}tr.run td:first-child{padding-left:1.1rem}
tr.picked td{background:var(--over)}td.best{color:var(--best)}
td.best::before{content:"▸ "}
mark{background:var(--mark);color:var(--ink);border-radius:.3rem;padding:.05rem .4rem;
font:.78rem ui-monospace,monospace;display:inline-block;margin:.1rem .25rem .1rem 0;
overflow-wrap:anywhere}
td:first-child{min-width:10rem;white-space:normal}
tr.settings div{position:sticky;left:0;max-width:calc(100vw - 3rem)}
svg.faded [id^="line-"]{opacity:.1}
"""
# Pointing at a row shows its curves alone; without a script all are shown.
_SCRIPT = """
const figures=document.querySelectorAll("svg");
const rows=document.querySelectorAll("[data-group]");
const lines=name=>document.querySelectorAll(`svg [id^="line-${name}"]`);
function pick(index){figures.forEach(f=>f.classList.toggle("faded",index!==null));
lines("").forEach(l=>l.style.opacity="");
if(index!==null)lines(`${index}-`).forEach(l=>l.style.opacity="1");
rows.forEach(r=>r.classList.toggle("picked",r.dataset.group===index));}
let kept=null;
rows.forEach(row=>{row.onmouseenter=()=>pick(row.dataset.group);
row.onmouseleave=()=>pick(kept);
row.onclick=()=>{kept=kept===row.dataset.group?null:row.dataset.group;pick(kept);};});
"""


def write_comparison(folder: Path, groups: Sequence[Group]) -> Path:
    """Write index.html, curves.png and curves.svg into a folder; the path of the page.

    Raises:
      ValueError: there are no runs.
    """
    if not groups:
        raise ValueError("groups must be at least one, but there are none; pass some.")
    roomy, narrow = draw_comparison(groups, folder / "curves.png")
    count = sum(len(group.runs) for group in groups)
    title = f"{count} runs side by side" if count > 1 else "One run"
    body = (
        f"<h1>{title}</h1>\n<p>{html.escape(_explain(groups))}</p>\n"
        f"{_write_table(groups)}{_list_common(groups)}"
        f"<h2>Error against run time</h2><p>{_HOW_TO_READ}</p>\n"
        f'<div class="curves roomy">{roomy}</div>\n'
        f'<div class="curves narrow">{narrow}</div>\n'
        f"<script>{_SCRIPT}</script>"
    )
    page = assemble_page(title, body, style=_STYLE)
    return write_text(folder / "index.html", page)


def tabulate_groups(groups: Sequence[Group]) -> str:
    """The table as Markdown, without the settings, for a terminal."""
    columns = _choose_columns(groups)
    rows = []
    for group in groups:
        if len(group.runs) > 1:
            rows.append([_name(group), *(_describe(group, name) for name in columns)])
        for run in group.runs:
            rows.append([run.name, *(_format(run, name) for name in columns)])
    return format_table(["Run", *(COLUMNS[name] for name in columns)], rows)


def _explain(groups: Sequence[Group]) -> str:
    """How to read the table; only what it has."""
    parts = ["Figures of the test split."]
    if any(len(group.runs) > 1 for group in groups):
        parts.append(
            "Runs that differ in the seed alone stand together, under their mean ± "
            "standard deviation (n − 1)."
        )
    if any(group.differs for group in groups):
        parts.append("Marked: settings that most others have otherwise.")
    if any(find_best(groups, name) for name in COLUMNS):
        parts.append("▸ is the best of its column, whatever the spread.")
    unfinished = [run for group in groups for run in group.runs if run.unfinished]
    if unfinished:
        parts.append(f"Not finished: {len(unfinished)}.")
    return " ".join(parts)


def _choose_columns(groups: Sequence[Group]) -> list[str]:
    found = [n for n in COLUMNS if any(g.summarize(n) is not None for g in groups)]
    return found or ["train_seconds"]


def _name(group: Group) -> str:
    return f"{group.name}, {len(group.runs)} seeds"


def _in_minutes(text: str, seconds: float | None) -> str:
    return text if seconds is None else f"{seconds / 60:.1f}"


def _describe(group: Group, metric: str) -> str:
    summary = group.summarize(metric)
    if metric != "train_seconds" or summary is None:
        return group.describe(metric)
    spread = "" if summary.spread is None else f" ± {summary.spread / 60:.1f}"
    return _in_minutes(MISSING, summary.mean) + spread


def _format(run: ComparedRun, metric: str) -> str:
    value = run.metrics.get(metric)
    shown = format_metric(metric, value)
    return _in_minutes(shown, value) if metric == "train_seconds" else shown


def _write_table(groups: Sequence[Group]) -> str:
    columns = _choose_columns(groups)
    best = {name: find_best(groups, name) for name in columns}
    heads = ["<th>Run</th>"] + [
        f"<th>{html.escape(COLUMNS[name])}</th>" for name in columns
    ]
    lines = [f"<tr>{''.join(heads)}</tr>"]
    for index, group in enumerate(groups):
        is_alone = len(group.runs) == 1
        first = group.runs[0]
        name = first.name + _say_unfinished(first) if is_alone else _name(group)
        cells = [f"<td>{html.escape(name)}</td>"]
        for metric in columns:
            kind = ' class="best"' if best[metric] is group else ""
            cells.append(f"<td{kind}>{_describe(group, metric)}</td>")
        lines.append(f'<tr class="group" data-group="{index}">{"".join(cells)}</tr>')
        if group.differs:
            width = f'colspan="{len(columns) + 1}"'
            marks = f"<td {width}><div>{_mark(group.differs)}</div></td>"
            lines.append(f'<tr class="settings" data-group="{index}">{marks}</tr>')
        for run in () if is_alone else group.runs:
            name = html.escape(run.name + _say_unfinished(run))
            cells = [f"<td>{name}</td>"]
            cells += [f"<td>{_format(run, m)}</td>" for m in columns]
            lines.append(f'<tr class="run" data-group="{index}">{"".join(cells)}</tr>')
    table = f'<table class="numbers">{"".join(lines)}</table>'
    return f'<div class="wide">{table}</div>\n'


def _say_unfinished(run: ComparedRun) -> str:
    return f" ({run.unfinished})" if run.unfinished else ""


def _mark(settings: Mapping[str, object]) -> str:
    return "".join(
        f"<mark>{html.escape(f'{name} {_show(value)}')}</mark>"
        for name, value in settings.items()
    )


def _show(value: object) -> str:
    return value if isinstance(value, str) and value else repr(value)


def _list_common(groups: Sequence[Group]) -> str:
    """What a setting is where it is not marked."""
    common = find_common([group.runs[0].fields for group in groups])
    if not common:
        return ""
    title = "The settings where nothing is marked"
    return f"<details><summary>{title}</summary>{_mark(common)}</details>\n"
