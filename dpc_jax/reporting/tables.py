"""Markdown tables: of any rows, and of the metrics of runs side by side."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dpc_jax.evaluation.metrics import format_metric, get_metric, order_metrics

# What a column of numbers holds: digits first, but for bold print; or nothing.
_NUMBER = re.compile(r"\**[-+]?(\d|inf|nan|–)|$")


def format_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], *, align: str = ""
) -> str:
    """A Markdown table, ending in a newline.

    Args:
      heads: of the columns.
      rows: cells by row, each as many as there are heads; shown by `str`. Pipes are
        escaped, line breaks become spaces.
      align: one letter per column, "l" or "r"; by default columns of numbers are
        aligned right, others left.

    Raises:
      TypeError: a row, or `align`, is of another length than the heads.
    """
    cells = [[_escape(cell) for cell in row] for row in rows]
    for line in [*cells, align or heads]:
        if len(line) != len(heads):
            raise TypeError(f"{len(heads)} columns, but cells {list(line)}")
    columns = list(zip(*cells, strict=True)) or [("",)] * len(heads)
    letters = align or [
        "r" if all(map(_NUMBER.match, column)) and any(column) else "l"
        for column in columns
    ]
    rule = ["---:" if letter == "r" else "---" for letter in letters]
    lines = [map(_escape, heads), rule, *cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def tabulate_runs(
    runs: Mapping[str, Mapping[str, Any]], *, columns: Sequence[str] | None = None
) -> str:
    """A Markdown table with a line per run and a column per metric; all if None.

    Raises:
      ValueError: there are no runs.
    """
    if not runs:
        raise ValueError("runs must be at least one, but there are none; pass some.")
    if columns is None:
        columns = order_metrics(name for metrics in runs.values() for name in metrics)
    return format_table(
        ["Run", *(get_metric(name).heading for name in columns)],
        [
            [run, *(format_metric(name, metrics.get(name)) for name in columns)]
            for run, metrics in runs.items()
        ],
    )


def _escape(cell: object) -> str:
    return " ".join(str(cell).replace("|", "\\|").split())
