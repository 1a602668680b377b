"""Markdown of the report's sections: headings, what failed, tables."""

import re
from collections.abc import Iterable, Sequence

# What a column of numbers holds: digits first, but for bold print; or nothing.
_NUMBER = re.compile(r"\**[-+]?(\d|inf|nan|–)|$")


def start_section(title: str, failures: Iterable[str] = ()) -> list[str]:
    """The lines that a section begins with: its heading, then what failed, if anything.

    Args:
      title: of the heading, which is of the second level.
      failures: a sentence each.
    """
    items = [f"- {failure}" for failure in failures]
    head = ["**Outside tolerance:**", "", *items, ""] if items else []
    return [f"## {title}", "", *head]


def make_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """The lines of a table; columns of numbers are aligned to the right.

    Args:
      head: a heading for each column.
      rows: cells, shown by `str`.
    """
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    columns = zip(*cells, strict=True)
    rules = [
        "---:" if all(_NUMBER.match(cell) for cell in column) else "---"
        for column in columns
    ] or ["---"] * len(head)
    return [f"| {' | '.join(line)} |" for line in (head, rules, *cells)]
