"""The report of a run: one HTML page that opens anywhere, with its data beside it."""

import base64
import html
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation import metrics as registry
from dpc_jax.files import write_text
from dpc_jax.reporting import export, figures, gallery, signals
from dpc_jax.reporting.examples import Example

_NAMED = 30  # objects
_CAPTIONS = {
    "curves": (
        "Error against run time",
        "Validation during training over seconds of wall clock. Accuracy should climb "
        "and the others fall; a curve that is still moving at its right end asks for "
        "more steps, and an accuracy that settles near 50 % hints at flipped poses.",
    ),
    "predictions": (
        "Predictions on test inputs",
        "Each row is one view the network never trained on. In the difference, red is "
        "predicted but not there and blue is missing. The shape is turned to two fixed "
        "directions, whatever the input's; darker points, or stronger colours, are "
        "nearer.",
    ),
    "signals": (
        "Rendered images",
        "Each signal as the data have it, as the prediction looks from its predicted "
        "pose, and the difference: red is too large or too far, blue too small or too "
        "near, and for colours the brighter, the more they differ.",
    ),
    "pose_errors": (
        "Pose errors",
        "The angle between predicted and true pose over all test views. Good poses "
        "pile up at the left, blue bars count as accurate; a second pile near 180° are "
        "views with front and back exchanged.",
    ),
    "candidates": (
        "Pose candidates",
        "How often each member of the pose ensemble explains a view best. Grey bars "
        "win less than 1 % and have stopped learning; with a single bar left the "
        "ensemble works like one regressor.",
    ),
}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#22303c;background:#fff;margin:0 auto;
max-width:62rem;padding:1rem}
h1{font-size:1.6rem;margin:.5rem 0 1rem}h2{font-size:1.2rem;margin:2rem 0 .3rem}
p{margin:.3rem 0 .8rem;max-width:46rem}.hint{color:#5f6c77;font-size:.9rem}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.6rem}
.tile{background:#f3f6f9;border-radius:.5rem;padding:.6rem .8rem}
.tile b{display:block;font-size:1.5rem}.tile span{display:block;font-size:.82rem}
.warning{background:#fff4e5;border-left:.3rem solid #e0a030;padding:.5rem .8rem}
.wide{overflow-x:auto}img{max-width:100%;height:auto}.large img{min-width:34rem}
table{border-collapse:collapse;font-size:.92rem}
td,th{padding:.25rem .8rem .25rem 0;text-align:left;border-bottom:1px solid #e6eaee}
td:nth-child(2){text-align:right;font-variant-numeric:tabular-nums}
pre{background:#f3f6f9;padding:.8rem;overflow-x:auto;font-size:.8rem}
"""


def write_report(
    folder: str | os.PathLike,
    *,
    title: str,
    metrics: Mapping[str, Any],
    records: Sequence[Mapping] | Mapping[str, Sequence[Mapping]] = (),
    examples: Sequence[Example] = (),
    pose_errors: ArrayLike | None = None,
    lost: Sequence[str] = (),
    shares: ArrayLike | None = None,
    warnings: Sequence[str] = (),
    config_text: str = "",
) -> Path:
    """Write `metrics.json`, figures, point clouds and `index.html`; returns its path.

    The page holds its figures inside and needs no network; the point clouds lie in
    `points/` and are linked. A section whose data are missing is left out. Files are
    replaced one by one, each whole; files of other names are left alone.

    Args:
      metrics: numbers, words or None by name, at least those of `REQUIRED_METRICS`
        (None where one does not apply). Distances times 100. NaN becomes null.
      records: lines of `metrics.jsonl`, or such lists by run name.
      pose_errors: errors of the test views in degrees, any shape.
      lost: names of objects that are wrong in all their views.
      shares: [K] share of views that each candidate wins.
      warnings: sentences for the top of the page.
      config_text: the configuration, shown as it is.

    Raises:
      ValueError: a required metric is missing, or a metric is not a single value.
    """
    folder = Path(folder)
    values = _plain_metrics(metrics)
    text = json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"
    write_text(folder / "metrics.json", text)

    drawings: list[tuple[str, Callable[..., Path], Any]] = [
        ("curves", figures.draw_curves, records or None),
        ("predictions", gallery.draw_predictions, examples or None),
        ("signals", signals.draw_signals, _list_with_signals(examples)),
        ("pose_errors", figures.draw_pose_errors, pose_errors),
        ("candidates", figures.draw_candidates, shares),
    ]
    sections = []
    for name, draw, data in drawings:
        if data is not None:
            sections.append(_embed_figure(name, draw(data, folder / f"{name}.png")))
            if name == "predictions":
                sections.append(_write_clouds(examples, folder / "points"))
            if name == "pose_errors":
                sections.append(_describe_failures(values, lost))
    sections.append(_list_metrics(values))
    if config_text:
        sections.append(
            "<h2>Configuration</h2><details><summary>Show the settings of this run"
            f"</summary><pre>{html.escape(config_text)}</pre></details>"
        )
    return write_text(
        folder / "index.html", _assemble(title, values, warnings, sections)
    )


def _list_with_signals(examples: Sequence[Example]) -> list[Example] | None:
    """Examples with renders of more than the silhouette; None if there are none."""
    return [e for e in examples if set(e.signals) - {"silhouette"}] or None


def _plain_metrics(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The metrics as JSON holds them, after a check that none is missing."""
    required = registry.REQUIRED_METRICS
    missing = [name for name in required if name not in metrics]
    if missing:
        raise ValueError(
            f"metrics must hold {', '.join(required)}, but there is none for "
            f"{', '.join(missing)}; pass None for one that does not apply."
        )
    plain = {}
    for name, value in metrics.items():
        if np.ndim(value) != 0:
            raise ValueError(
                f"Metric {name!r} must be a single value, but has shape "
                f"{np.shape(value)}; pass its mean, and arrays by their own arguments."
            )
        if hasattr(value, "item"):  # numpy and jax scalars
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            value = None
        plain[name] = value
    return plain


def _assemble(title, values, warnings, sections) -> str:
    """The page: warnings, the headline metrics as tiles, then the sections."""
    notes = "".join(f'<p class="warning">{html.escape(note)}</p>' for note in warnings)
    tiles = ""
    for name in registry.HEADLINE_METRICS:
        value = html.escape(registry.format_metric(name, values[name]))
        heading = html.escape(registry.get_metric(name).heading)
        tiles += f'<div class="tile"><b>{value}</b><span>{heading}</span></div>'
    title = html.escape(title)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body>"
        f'<h1>{title}</h1>\n{notes}<div class="tiles">{tiles}</div>\n'
        f"{''.join(sections)}</body></html>\n"
    )


def _embed_figure(name: str, path: Path) -> str:
    """A figure inside the page, under its title and a sentence on how to read it."""
    title, caption = _CAPTIONS[name]
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    # Small print would be lost on a phone: the detailed figures scroll sideways there.
    kind = "wide large" if name in ("curves", "predictions", "signals") else "wide"
    return (
        f"<h2>{html.escape(title)}</h2><p>{html.escape(caption)}</p>"
        f'<div class="{kind}"><img alt="{html.escape(title)}" '
        f'src="data:image/png;base64,{data}"></div>\n'
    )


def _list_metrics(values: Mapping[str, Any]) -> str:
    rows = []
    for name in registry.order_metrics(values):
        metric = registry.get_metric(name)
        hint = metric.hint
        if hint and metric.higher_is_better is not None:
            hint += f"; {'higher' if metric.higher_is_better else 'lower'} is better"
        value = registry.format_metric(name, values[name])
        heading, value, hint = map(html.escape, (metric.heading, value, hint))
        rows.append((heading, value, f'<span class="hint">{hint}</span>'))
    return (
        "<h2>All metrics</h2><p>Of the test split; the same numbers, unrounded and "
        'with shares from 0 to 1, are in <a href="metrics.json">metrics.json</a>.</p>'
        + _make_table(rows)
    )


def _describe_failures(values: Mapping[str, Any], lost: Sequence[str]) -> str:
    """What the wrong views are, and which objects are wrong in all of theirs."""
    names = (
        "wrong_half_turn_share",
        "wrong_mirror_share",
        "truth_cheaper_share",
        "wrong_object_share",
    )
    rows = [
        (
            html.escape(registry.get_metric(name).heading),
            html.escape(registry.format_metric(name, values[name])),
            f'<span class="hint">{html.escape(registry.get_metric(name).hint)}</span>',
        )
        for name in names
        if values.get(name) is not None
    ]
    text = f"<h3>What the wrong views are</h3>{_make_table(rows)}" if rows else ""
    if lost:
        shown = ", ".join(lost[:_NAMED]) + (", ..." if len(lost) > _NAMED else "")
        text += f"<p>Wrong in all views: {html.escape(shown)}.</p>"
    return text


def _write_clouds(examples: Sequence[Example], folder: Path) -> str:
    """Write the point clouds of the examples; a table of links to them."""
    rows, taken = [], set()
    for example in examples:
        stem = _file_name(example.name, taken)
        write_files(example, folder / stem)
        error = example.pose_error_deg
        error_text = registry.MISSING if error is None else f"{error:.1f}°"
        links = [f'<a href="points/{stem}.{k.lower()}">{k}</a>' for k in ("GLB", "PLY")]
        rows.append((html.escape(example.name), error_text, *links))
    return (
        "<p>The same shapes as files: GLB opens in any 3D viewer, PLY in point cloud "
        "tools; both are in the object frame of the data set.</p>"
        + _make_table(rows, heads=("Example", "Pose error", "", ""))
    )


def write_files(example: Example, stem: Path):
    """STEM.ply of an example's points, and STEM.glb of them or of its surface."""
    export.write_ply(stem.with_name(f"{stem.name}.ply"), example.points, example.colors)
    glb = stem.with_name(f"{stem.name}.glb")
    if example.mesh is not None:
        export.write_surface(glb, *example.mesh)
    else:
        export.write_glb(glb, example.points, example.colors)


def _make_table(rows: Iterable[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """A table of cells that are HTML; the second column holds numbers."""
    lines = ["".join(f"<th>{head}</th>" for head in heads)] if heads else []
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f'<div class="wide"><table>{body}</table></div>\n'


def _file_name(name: str, taken: set[str]) -> str:
    """A name safe in any file system and link, different from those taken."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:80] or "example"
    unique, count = stem, 2
    while unique.lower() in taken:
        unique, count = f"{stem}_{count}", count + 1
    taken.add(unique.lower())
    return unique
