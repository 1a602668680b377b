"""Arguments that share a line of a docstring get a line each in the reference.

For griffe, which reads docstrings for the site: it takes `scale, sigma: voxels` for one
argument with a comma in its name. mkdocs.yml names this file.
"""

import re
from typing import Any

import griffe

_JOINED = re.compile(
    r"^  (?P<names>\w+(?:, \w+)+): (?P<text>.*(?:\n    .*)*)", flags=re.MULTILINE
)


class JoinedNames(griffe.Extension):
    """Spreads the lines of every docstring."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = spread(obj.docstring.value)


def spread(docstring: str) -> str:
    """The docstring with a line for each of several names before a colon."""
    return _JOINED.sub(_repeat, docstring)


def _repeat(match: re.Match[str]) -> str:
    names = match["names"].split(", ")
    return "\n".join(f"  {name}: {match['text']}" for name in names)
