"""The report of a run: one HTML page that opens anywhere, with its data beside it."""

import functools
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

from dpc_jax.evaluation import metrics as registry
from dpc_jax.files import write_text
from dpc_jax.reporting import export, figures, gallery, signals
from dpc_jax.reporting.examples import Example, TrainingComparison
from dpc_jax.reporting.web import cards, sections, viewer
from dpc_jax.reporting.web.markup import assemble_page, embed_chart, make_table


def write_report(
    folder: str | os.PathLike,
    *,
    title: str,
    metrics: Mapping[str, Any],
    records: Sequence[Mapping] = (),
    stages: figures.Stages = (),
    examples: Sequence[Example] = (),
    ranking: str = "",
    worst: tuple[Sequence[Example], str] = ((), ""),
    pose_errors: ArrayLike | None = None,
    view_poses: figures.ViewPoses | None = None,
    lost: Sequence[str] = (),
    comparison: TrainingComparison | None = None,
    shares: ArrayLike | None = None,
    warnings: Sequence[str] = (),
    config_text: str = "",
) -> Path:
    """Write `metrics.json`, figures, point clouds and `index.html`; returns its path.

    The page holds its figures and scripts inside and needs no network; the point clouds
    lie in `points/` and are linked. A section whose data are missing is left out. Files
    are replaced one by one, each whole; files of other names are left alone.

    Args:
      metrics: numbers, words or None by name, at least those of `REQUIRED_METRICS`
        (None where one does not apply). Distances times 100. NaN becomes null.
      records: lines of `metrics.jsonl`.
      stages: first step of each stage of the schedule and what is new in it.
      examples: views to show, those of a group one after the other.
      ranking: how they were chosen, a sentence.
      worst: the worst objects, each by a view, and how they were chosen.
      pose_errors: errors of the test views in degrees, any shape.
      view_poses: where the test views are taken from, and said to be.
      lost: names of objects that are wrong in all their views.
      comparison: of the predictions with what the training set has.
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
    parts = []
    if examples:
        # One picture of all, for other pages; this one shows them larger.
        gallery.draw_predictions(examples, folder / "predictions.png")
        parts += [
            viewer.show_clouds(examples),
            sections.introduce("predictions", ranking),
            cards.show_examples(examples),
            _write_clouds(examples, folder / "points"),
        ]
    parts.append(_show_worst(folder, *worst))
    parts.append(_draw(folder, "pose_errors", figures.draw_pose_errors, pose_errors))
    parts.append(_draw(folder, "azimuths", figures.draw_azimuths, view_poses))
    if pose_errors is not None:
        parts.append(sections.describe_failures(values, lost))
    if comparison:
        parts.append(sections.introduce("training_shapes"))
        parts.append(sections.compare_with_training(comparison))
    draw_curves = functools.partial(figures.draw_curves, stages=stages)
    parts.append(_draw(folder, "curves", draw_curves, records or None))
    parts.append(_draw(folder, "candidates", figures.draw_candidates, shares))
    shown = _list_with_signals(examples)
    parts.append(_draw(folder, "signals", signals.draw_signals, shown, is_photo=True))
    parts.append(sections.list_metrics(values))
    if config_text:
        parts.append(sections.show_config(config_text))
    if examples:
        parts.append(viewer.embed_scripts(examples))
    page = _assemble(title, values, warnings, parts)
    return write_text(folder / "index.html", page)


def _draw(folder, name, draw, data, *, is_photo: bool = False) -> str:
    """A section with a figure; "" where there are no data for it."""
    if data is None:
        return ""
    path = draw(data, folder / f"{name}.png")
    title, _ = sections.CAPTIONS[name]
    return sections.introduce(name) + embed_chart(path, title, is_photo=is_photo)


def _show_worst(folder: Path, examples: Sequence[Example], ranking: str) -> str:
    """The section of the worst objects; "" without any."""
    if not examples:
        return ""
    path = gallery.draw_predictions(examples, folder / "worst_objects.png")
    title, _ = sections.CAPTIONS["worst_objects"]
    start = sections.introduce("worst_objects", ranking)
    return start + embed_chart(path, title, is_photo=True)


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


def _assemble(title, values, warnings, parts) -> str:
    """The page: warnings, the headline metrics as tiles, then the sections."""
    notes = "".join(f'<p class="warning">{html.escape(note)}</p>' for note in warnings)
    shown = (*registry.HEADLINE_METRICS, "silhouette_iou")  # known of every set
    tiles = ""
    for name in registry.order_metrics(n for n in shown if values.get(n) is not None):
        value = html.escape(registry.format_metric(name, values[name]))
        heading = html.escape(registry.get_metric(name).heading)
        tiles += f'<div class="tile"><b>{value}</b><span>{heading}</span></div>'
    top = f'<h1>{html.escape(title)}</h1>\n{notes}<div class="tiles">{tiles}</div>\n'
    return assemble_page(title, top + "".join(parts))


def _write_clouds(examples: Sequence[Example], folder: Path) -> str:
    """Write the point clouds of the examples; a table of links to them."""
    rows, taken = [], set()
    for example in examples:
        stem = _file_name(example.name, taken)
        write_files(example, folder / stem)
        links = [f'<a href="points/{stem}.{k.lower()}">{k}</a>' for k in ("GLB", "PLY")]
        rows.append((html.escape(viewer.name_example(example)), " ".join(links)))
    return (
        "<details><summary>The same shapes as files</summary><p>GLB opens in any 3D "
        "viewer, PLY in point cloud tools; both are in the object frame of the data "
        f"set.</p>{make_table(rows)}</details>\n"
    )


def write_files(example: Example, stem: Path):
    """STEM.ply of an example's points, and STEM.glb of them or of its surface."""
    export.write_ply(stem.with_name(f"{stem.name}.ply"), example.points, example.colors)
    glb = stem.with_name(f"{stem.name}.glb")
    if example.mesh is not None:
        export.write_surface(glb, *example.mesh)
    else:
        export.write_glb(glb, example.points, example.colors)


def _file_name(name: str, taken: set[str]) -> str:
    """A name safe in any file system and link, different from those taken."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:80] or "example"
    unique, count = stem, 2
    while unique.lower() in taken:
        unique, count = f"{stem}_{count}", count + 1
    taken.add(unique.lower())
    return unique
