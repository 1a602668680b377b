"""Metrics as readers want to see them: named, rounded, with units."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Column(NamedTuple):
    """How one metric is shown.

    Attributes:
      label: heading, with the unit.
      spec: format of the scaled number, as for ``format``.
      factor: the number is shown times this.
      hint: one phrase on what it means.
    """

    label: str
    spec: str = ".4g"
    factor: float = 1.0
    hint: str = ""


COLUMNS = {
    "pose_accuracy": Column(
        "Pose accuracy (%)", ".1f", 100.0, "views posed within 30° of the truth"
    ),
    "pose_median_error_deg": Column(
        "Median pose error (°)", ".1f", 1.0, "half of the views are nearer to the truth"
    ),
    "chamfer": Column(
        "Chamfer distance (×100)", ".2f", 1.0, "precision plus coverage; low is good"
    ),
    "precision": Column(
        "Precision (×100)", ".2f", 1.0, "mean distance, prediction to truth"
    ),
    "coverage": Column(
        "Coverage (×100)", ".2f", 1.0, "mean distance, truth to prediction"
    ),
    "flip_share": Column(
        "Flipped views (%)", ".1f", 100.0, "wrong by more than 150°, front as back"
    ),
    "best_candidate_pose_accuracy": Column(
        "Pose accuracy, best candidate (%)", ".1f", 100.0, "the ensemble's winner"
    ),
    "best_candidate_pose_median_error_deg": Column(
        "Median pose error, best candidate (°)", ".1f", 1.0, "same, for the winner"
    ),
    "silhouette_iou": Column(
        "Silhouette overlap (%)", ".1f", 100.0, "intersection over union with the masks"
    ),
    "train_seconds": Column(
        "Training time (s)", ".0f", 1.0, "wall clock, compilation included"
    ),
    "peak_memory_gb": Column("Peak memory (GB)", ".1f", 1.0, "of the training process"),
}
# Of metrics on objects of the training source, where another one is tested on.
_OWN = "own_"


def describe(name: str) -> Column:
    """The column of a metric; an unknown one is shown by its name with 4 digits."""
    plain = name.removeprefix(_OWN)
    if plain != name and plain in COLUMNS:
        column = COLUMNS[plain]
        return column._replace(label=f"{column.label}, training source")
    return COLUMNS.get(name, Column(name))


def format_metric(name: str, value: Any) -> str:
    """A metric in its unit and precision; an en dash where it is missing or NaN."""
    if value is None:
        return "–"
    if isinstance(value, bool | str):
        return str(value)
    if not math.isfinite(value):
        return "–"
    column = describe(name)
    return format(column.factor * float(value), column.spec)


def order_metrics(names: Sequence[str]) -> list[str]:
    """Names in the table's order: the known ones first, the others by the alphabet."""
    known = [name for name in COLUMNS if name in names]
    return known + sorted(set(names) - set(known))


def markdown_table(
    runs: Mapping[str, Mapping[str, Any]], *, columns: Sequence[str] | None = None
) -> str:
    """A Markdown table with a line per run and a column per metric.

    Args:
      runs: the metrics of each run by its name; they need not hold the same ones.
      columns: names of the metrics to show, in this order; all of them if None.

    Returns:
      The table, ending in a newline. Pipes in names are escaped.

    Raises:
      ValueError: there are no runs.
    """
    if not runs:
        raise ValueError("Expected at least one run to tabulate, got none; pass some.")
    if columns is None:
        columns = order_metrics([name for metrics in runs.values() for name in metrics])
    head = ["Run", *(describe(name).label for name in columns)]
    lines = [head, ["---", *("---:" for _ in columns)]]
    for run, metrics in runs.items():
        cells = (format_metric(name, metrics.get(name)) for name in columns)
        lines.append([run, *cells])
    return "".join("| " + " | ".join(map(_escape, line)) + " |\n" for line in lines)


def _escape(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
