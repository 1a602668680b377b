"""The report of a run: one HTML page that opens anywhere, with its data beside it."""

import os
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from dpc_jax.evaluation import metrics as registry
from dpc_jax.evaluation.pose import Failures
from dpc_jax.files import write_json, write_text
from dpc_jax.reporting import figures
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.export import write_files
from dpc_jax.reporting.gallery import draw_predictions, draw_signals
from dpc_jax.reporting.tables import make_table
from dpc_jax.reporting.web import viewer
from dpc_jax.reporting.web.markup import assemble_page, embed_chart

# Title of a section, and how to read it.
CAPTIONS = {
    "predictions": (
        "Predictions on test views",
        "Views that the network never trained on. In the difference of the silhouettes "
        "red is too much, blue is missing. All shapes are lit and seen from the same "
        "direction, whatever the input's; Chamfer distances are times 100, to the true "
        "shape.",
    ),
    "azimuths": (
        "Pose errors over azimuth",
        "Each point is a test view. A band at the top over a range of azimuths is a "
        "part of the poses that the network has learned the wrong way round; single "
        "points are single objects.",
    ),
    "training_shapes": (
        "Beside shapes that see no image",
        "Chamfer distances (× 100) to true shapes, means over the test objects. A "
        "perfect cloud has as many points of the true surface as a prediction. A "
        "network that ignores its input is no nearer to the truth than the mean of its "
        "predictions. The mean and the nearest training shape know true surfaces; the "
        "network learns from images.",
    ),
    "curves": (
        "Over run time",
        "All but the loss and the candidates are of validation, at one size of points "
        "and one grid. The loss may climb while everything improves: points become "
        "smaller, and by default the grid finer after 60 % of the steps. An accuracy "
        "that settles near 50 % hints at flipped poses; a curve still moving at its "
        "right end asks for more steps. The loss has a "
        "logarithmic scale; candidates are alive that win at least 1 % of the views.",
    ),
    "signals": (
        "Rendered images",
        "Each signal as the data have it, as the prediction looks from its predicted "
        "pose, and the difference: red is too large or too far, blue too small or too "
        "near, and for colours the brighter, the more they differ.",
    ),
}


def write_report(
    folder: str | os.PathLike,
    *,
    title: str,
    metrics: Mapping[str, Any],
    records: Sequence[Mapping] = (),
    examples: Sequence[Example] = (),
    ranking: str = "",
    failures: Failures | None = None,
    warnings: Sequence[str] = (),
    config_text: str = "",
) -> Path:
    """Write `metrics.json`, figures, point clouds and `index.html`; returns its path.

    The page holds its figures and scripts inside and needs no network; the point clouds
    lie in `points/` and are linked. A section whose data are missing is left out. Files
    are replaced one by one, each whole; files of other names are left alone.

    Args:
      metrics: numbers, words or None by name. Distances times 100. NaN becomes null.
      records: lines of `metrics.jsonl`.
      examples: views to show, those of a group one after the other.
      ranking: how they were chosen, a sentence.
      failures: of the poses of the test views.
    """
    folder = Path(folder)
    values = dict(sorted(metrics.items()))
    write_json(folder / "metrics.json", values)
    rendered = [e for e in examples if e.images and len(e.images.rendered) > 1]
    parts = [
        _begin(title, values, warnings),
        viewer.show_clouds(examples) if examples else "",
        _draw(
            folder, "predictions", draw_predictions, examples, ranking, is_photo=True
        ),
        _write_clouds(examples, folder / "points") if examples else "",
        _draw(folder, "azimuths", figures.draw_azimuths, failures),
        _compare_shapes(values),
        _draw(folder, "curves", figures.draw_curves, records),
        _draw(folder, "signals", draw_signals, rendered, is_photo=True),
        _list_metrics(values),
    ]
    if config_text:
        parts.append(
            "<h2>Configuration</h2><details><summary>Show the settings of this run"
            f"</summary><pre>{escape(config_text)}</pre></details>\n"
        )
    if examples:
        parts.append(viewer.embed_scripts(examples))
    return write_text(folder / "index.html", assemble_page(title, "".join(parts)))


def _begin(title, values, warnings) -> str:
    """The heading, warnings, and the headline metrics as tiles."""
    notes = "".join(f'<p class="warning">{escape(note)}</p>' for note in warnings)
    shown = (*registry.HEADLINE_METRICS, "silhouette_iou")  # known of every set
    tiles = ""
    for name in registry.order_metrics(n for n in shown if values.get(n) is not None):
        value = escape(registry.format_metric(name, values[name]))
        heading = escape(registry.get_metric(name).heading)
        tiles += f'<div class="tile"><b>{value}</b><span>{heading}</span></div>'
    return f'<h1>{escape(title)}</h1>\n{notes}<div class="tiles">{tiles}</div>\n'


def _introduce(name: str, more: str = "") -> str:
    """The title of a section, and how to read it."""
    title, caption = CAPTIONS[name]
    text = f"{more} {caption}" if more else caption
    return f"<h2>{escape(title)}</h2><p>{escape(text)}</p>"


def _draw(folder, name, draw, data, more: str = "", *, is_photo: bool = False) -> str:
    """A section with a figure; "" where there are no data for it."""
    if not data:
        return ""
    path = draw(data, folder / f"{name}.png")
    chart = embed_chart(path, CAPTIONS[name][0], is_photo=is_photo)
    return _introduce(name, more) + chart


def _write_clouds(examples: Sequence[Example], folder: Path) -> str:
    """Write the point clouds of the examples; a table of links to them."""
    rows, taken = [], set()
    for example in examples:
        stem = _file_name(example.name, taken)
        write_files(example, folder / stem)
        links = [f'<a href="points/{stem}.{k.lower()}">{k}</a>' for k in ("GLB", "PLY")]
        measures = escape(", ".join(example.list_measures()))
        rows.append((escape(example.title), " ".join(links), measures))
    return (
        "<details><summary>The same shapes as files</summary><p>GLB is the surface, "
        "for any 3D viewer; PLY the points, for tools of clouds and of Gaussian "
        "splats. Both are in the object frame of the data "
        f"set.</p>{make_table(rows)}</details>\n"
    )


def _file_name(name: str, taken: set[str]) -> str:
    """A name safe in any file system and link, different from those taken."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:80] or "example"
    unique, count = stem, 2
    while unique.lower() in taken:
        unique, count = f"{stem}_{count}", count + 1
    taken.add(unique.lower())
    return unique


def _compare_shapes(values: Mapping[str, Any]) -> str:
    """Predictions beside shapes that see no image, and a perfect cloud."""
    named = {"chamfer": "Predictions"} | {
        name: metric.label.removeprefix("Chamfer distance, ")
        for name, metric in registry.METRICS.items()
        if metric.role == "reference"
    }
    columns = [p for p in ("", "visible_") if f"{p}floor_chamfer" in values]
    rows = [
        (
            escape(label[:1].upper() + label[1:]),
            *(registry.format_metric(name, values.get(p + name)) for p in columns),
        )
        for name, label in named.items()
    ]
    heads = ("", "whole surface", "visible surface")[: 1 + len(columns)]
    table = make_table(rows, heads, kind="numbers")
    return _introduce("training_shapes") + table if columns else ""


def _list_metrics(values: Mapping[str, Any]) -> str:
    """A table of all metrics, each with its meaning."""
    rows = []
    for name in registry.order_metrics(values):
        metric = registry.get_metric(name)
        more = {None: "", True: "; higher is better", False: "; lower is better"}
        hint = metric.hint + more[metric.higher_is_better] if metric.hint else ""
        shown = escape(registry.format_metric(name, values[name]))
        hint = f'<span class="hint">{escape(hint)}</span>'
        rows.append((escape(metric.heading), shown, hint))
    return (
        "<h2>All metrics</h2><p>Of the test split; the same numbers, unrounded and "
        'with shares from 0 to 1, are in <a href="metrics.json">metrics.json</a>.</p>'
        + make_table(rows)
    )
