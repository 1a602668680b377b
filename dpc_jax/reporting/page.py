"""The report of a run: one HTML page that opens anywhere, with its data beside it."""

import base64
import html
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.files import write_text
from dpc_jax.reporting import export, figures, gallery, tables
from dpc_jax.reporting.examples import Example

REQUIRED_METRICS = (
    "chamfer",
    "coverage",
    "pose_accuracy",
    "pose_median_error_deg",
    "precision",
    "train_seconds",
)
HEADLINES = ("pose_accuracy", "pose_median_error_deg", "chamfer", "train_seconds")
CAPTIONS = {
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
STYLE = """
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
td.number{text-align:right;font-variant-numeric:tabular-nums}
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
    shares: ArrayLike | None = None,
    warnings: Sequence[str] = (),
    config_text: str = "",
) -> Path:
    """Write ``metrics.json``, figures, point clouds and ``index.html`` into a folder.

    The page holds its figures inside and needs no network; the point clouds lie in
    ``points/`` and are linked. A section whose data are missing is left out. Files are
    replaced one by one, each whole; files of other names are left alone.

    Args:
      folder: made where it does not exist.
      title: of the page.
      metrics: numbers, words or None by name, at least those of ``REQUIRED_METRICS``
        (None where one does not apply). Distances times 100. NaN becomes null.
      records: lines of ``metrics.jsonl``, or such lists by run name.
      examples: predictions to show.
      pose_errors: errors of the test views in degrees, any shape.
      shares: [K] share of views that each candidate wins.
      warnings: sentences for the top of the page.
      config_text: the configuration, shown as it is.

    Returns:
      The path of ``index.html``.

    Raises:
      ValueError: a required metric is missing, or a metric is not a single value.
    """
    folder = Path(folder)
    values = _plain_metrics(metrics)
    text = json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"
    write_text(folder / "metrics.json", text)

    sections = []
    if records:
        path = figures.draw_curves(records, folder / "curves.png")
        sections.append(_figure("curves", path))
    if examples:
        path = gallery.draw_predictions(examples, folder / "predictions.png")
        sections.append(_figure("predictions", path))
        sections.append(_clouds(examples, folder / "points"))
    if pose_errors is not None:
        path = figures.draw_pose_errors(pose_errors, folder / "pose_errors.png")
        sections.append(_figure("pose_errors", path))
    if shares is not None:
        path = figures.draw_candidates(shares, folder / "candidates.png")
        sections.append(_figure("candidates", path))
    return write_text(
        folder / "index.html",
        _assemble(title, values, warnings, sections, config_text),
    )


def _plain_metrics(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The metrics as JSON holds them, once the required ones are known to be there."""
    missing = [name for name in REQUIRED_METRICS if name not in metrics]
    if missing:
        raise ValueError(
            f"Expected at least the metrics {', '.join(REQUIRED_METRICS)}, got none "
            f"for {', '.join(missing)}; pass None for one that does not apply."
        )
    plain = {}
    for name, value in metrics.items():
        if np.ndim(value) != 0:
            raise ValueError(
                f"Expected metric {name!r} to be a single value, got shape "
                f"{np.shape(value)}; pass its mean, and arrays by their own arguments."
            )
        if hasattr(value, "item"):  # numpy and jax scalars
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            value = None
        plain[name] = value
    return plain


def _assemble(title, values, warnings, sections, config_text) -> str:
    names = tables.order_metrics(list(values))
    shown = {name: tables.format_metric(name, values[name]) for name in names}
    tiles = "".join(
        f'<div class="tile"><b>{html.escape(shown[name])}</b>'
        f"<span>{html.escape(tables.describe(name).label)}</span></div>"
        for name in HEADLINES
    )
    rows = "".join(
        f"<tr><td>{html.escape(tables.describe(name).label)}</td>"
        f'<td class="number">{html.escape(shown[name])}</td>'
        f'<td class="hint">{html.escape(tables.describe(name).hint)}</td></tr>'
        for name in names
    )
    notes = "".join(f'<p class="warning">{html.escape(note)}</p>' for note in warnings)
    config = ""
    if config_text:
        config = (
            "<h2>Configuration</h2><details><summary>Show the settings of this run"
            f"</summary><pre>{html.escape(config_text)}</pre></details>"
        )
    heading = html.escape(title)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{heading}</title><style>{STYLE}</style></head>\n<body>"
        f"<h1>{heading}</h1>\n{notes}"
        f'<div class="tiles">{tiles}</div>\n{"".join(sections)}'
        "<h2>All metrics</h2><p>Of the test split; the same numbers, unrounded and "
        'with shares from 0 to 1, are in <a href="metrics.json">metrics.json</a>.</p>'
        f'<div class="wide"><table>{rows}</table></div>\n{config}'
        "</body></html>\n"
    )


def _figure(name: str, path: Path) -> str:
    """A figure inside the page, under its title and a sentence on how to read it."""
    title, caption = CAPTIONS[name]
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    # Small print would be lost on a phone: the detailed figures scroll sideways there.
    kind = "wide large" if name in ("curves", "predictions") else "wide"
    return (
        f"<h2>{html.escape(title)}</h2><p>{html.escape(caption)}</p>"
        f'<div class="{kind}"><img alt="{html.escape(title)}" '
        f'src="data:image/png;base64,{data}"></div>\n'
    )


def _clouds(examples: Sequence[Example], folder: Path) -> str:
    """Write the point clouds of the examples; a table of links to them."""
    rows, taken = [], set()
    for example in examples:
        stem = _file_name(example.name, taken)
        export.write_ply(folder / f"{stem}.ply", example.points, example.colors)
        export.write_glb(folder / f"{stem}.glb", example.points, example.colors)
        error = example.pose_error_deg
        rows.append(
            f"<tr><td>{html.escape(example.name)}</td>"
            f'<td class="number">{"–" if error is None else f"{error:.1f}°"}</td>'
            f'<td><a href="points/{stem}.glb">GLB</a></td>'
            f'<td><a href="points/{stem}.ply">PLY</a></td></tr>'
        )
    return (
        "<p>The same shapes as files: GLB opens in any 3D viewer, PLY in point cloud "
        "tools; both are in the object frame of the data set.</p>"
        '<div class="wide"><table><tr><th>Example</th><th>Pose error</th><th></th>'
        f"<th></th></tr>{''.join(rows)}</table></div>\n"
    )


def _file_name(name: str, taken: set[str]) -> str:
    """A name safe in any file system and link, different from those taken."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:80] or "example"
    unique, count = stem, 2
    while unique.lower() in taken:
        unique, count = f"{stem}_{count}", count + 1
    taken.add(unique.lower())
    return unique
