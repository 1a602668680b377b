"""Fields of the config sections: a default, and the values that are allowed."""

import dataclasses
import math
import os
import re
from collections.abc import Callable
from typing import Any, NamedTuple


class Allowed(NamedTuple):
    """Which values a field may have.

    Attributes:
      holds: whether a value is one of them.
      text: a description that completes "must be …".
    """

    holds: Callable[[Any], bool]
    text: str


_MOST = 2**31 - 1
# Of every field: steps and seeds are counted in int32.
COUNTABLE = Allowed(
    lambda value: not isinstance(value, int) or value <= _MOST, f"at most {_MOST:,}"
)
FOLDER = Allowed(
    lambda value: not value or os.path.isdir(value), "a folder that exists"
)
FOLD = Allowed(
    lambda value: not value or bool(read_fold(value)),
    "'' or PART/PARTS: of so many parts that one is tested, counted from 0",
)


def read_fold(text: str) -> tuple[int, int] | None:
    """(i, n) of "i/n", the i-th of n parts, counted from 0; None for other texts."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found:
        return None
    part, parts = map(int, found.groups())
    return (part, parts) if parts > 1 and part < parts else None


def at_least(low: int) -> Allowed:
    """A number from `low` on."""
    text = f"{low} or more" if low == 0 else f"at least {low}"
    return Allowed(lambda value: low <= value < math.inf, text)


def between(low: float, high: float) -> Allowed:
    """A number from `low` to `high`, both allowed."""
    return Allowed(lambda value: low <= value <= high, f"between {low} and {high}")


def above(low: float, high: float = math.inf) -> Allowed:
    """A finite number above `low` and at most `high`."""
    text = f"above {low}" + (f" and at most {high}" if high < math.inf else "")
    return Allowed(lambda value: low < value <= high and value < math.inf, text)


def one_of(*values: str) -> Allowed:
    """One of some words."""
    shown = ", ".join(repr(value) for value in values[:-1])
    return Allowed(lambda value: value in values, f"{shown} or {values[-1]!r}")


def field(default: Any, allowed: Allowed) -> Any:
    """A dataclass field with a default and the values that are allowed."""
    return dataclasses.field(default=default, metadata={"allowed": allowed})
