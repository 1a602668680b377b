"""Markdown of the report's sections: headings, and what failed."""

from collections.abc import Iterable


def start_section(title: str, failures: Iterable[str] = ()) -> list[str]:
    """The lines that a section begins with: its heading, then what failed, if anything.

    Args:
      title: of the heading, which is of the second level.
      failures: a sentence each.
    """
    items = [f"- {failure}" for failure in failures]
    head = ["**Outside tolerance:**", "", *items, ""] if items else []
    return [f"## {title}", "", *head]
