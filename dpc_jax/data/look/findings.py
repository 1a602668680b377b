"""What a check has found."""

from collections.abc import Sequence
from typing import NamedTuple

NAMED = 5  # offenders that a finding names


class Finding(NamedTuple):
    """One fault of a set. level: "error", or "warning" if it may be intended."""

    level: str
    text: str


def name_places(places: Sequence[str]) -> str:
    """The first of some places as text, and how many more there are."""
    more = len(places) - NAMED
    return ", ".join(places[:NAMED]) + (f" and {more} more" if more > 0 else "")
