"""Tables of any rows: Markdown, and HTML."""

import re
from collections.abc import Iterable, Sequence

# What a column of numbers holds: digits first, but for marks; or nothing.
_NUMBER = re.compile(r"(\*\*)?[-+]?(\d|inf|nan|–)|$")


def format_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table, ending in a newline; columns of numbers are aligned right.

    Args:
      heads: of the columns.
      rows: cells by row, each as many as there are heads; shown by `str`. Pipes are
        escaped, line breaks become spaces.
    """
    cells = [[_escape(cell) for cell in row] for row in rows]
    rule = [
        "---:" if all(map(_NUMBER.match, column)) and any(column) else "---"
        for column in zip(*cells, strict=True)
    ]
    lines = [map(_escape, heads), rule, *cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _escape(cell: object) -> str:
    return " ".join(str(cell).replace("|", "\\|").split())


def make_table(
    rows: Iterable[Iterable[str]], heads: Iterable[str] = (), kind: str = ""
) -> str:
    """An HTML table of cells that are HTML; the second column holds numbers.

    Args:
      kind: class of the table; "numbers" where all columns after the first hold some.
    """
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines if line)
    named = f' class="{kind}"' if kind else ""
    return f'<div class="wide"><table{named}>{body}</table></div>\n'
