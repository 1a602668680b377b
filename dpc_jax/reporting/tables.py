"""Markdown tables of any rows."""

import re
from collections.abc import Iterable, Sequence

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


def _escape(cell: object) -> str:
    return " ".join(str(cell).replace("|", "\\|").split())
