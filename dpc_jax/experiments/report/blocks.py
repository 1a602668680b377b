"""A page as a list of blocks, written as HTML and as Markdown alike."""

import base64
import dataclasses
import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from dpc_jax.experiments.report.tables import Table
from dpc_jax.reporting.tables import format_table

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#22303c;background:#fff;margin:0 auto;
max-width:70rem;padding:1rem}
h1{font-size:1.6rem}h2{font-size:1.25rem;margin:2.4rem 0 .3rem}
p,ul{max-width:50rem;margin:.4rem 0 .8rem}.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.86rem}
th,td{padding:.25rem .6rem;border-bottom:1px solid #e6eaee;text-align:left}
th{font-weight:600;vertical-align:bottom}
td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
tr.first td{border-top:2px solid #8795a1}
img{max-width:100%;height:auto}figure{margin:1rem 0}figcaption{color:#5f6c77;
font-size:.9rem}.yes{color:#2c7a54}.no{color:#b3394a}
"""


@dataclasses.dataclass(frozen=True)
class Heading:
    """A heading; level 1 is the page's."""

    text: str
    level: int = 2


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str


@dataclasses.dataclass(frozen=True)
class Items:
    """A list of sentences."""

    texts: Sequence[str]


@dataclasses.dataclass(frozen=True)
class Figure:
    """A picture with its caption."""

    path: Path
    caption: str


Block = Heading | Paragraph | Items | Figure | Table
_TYPES = {".png": "image/png", ".gif": "image/gif", ".jpg": "image/jpeg"}


def write_markdown(blocks: Sequence[Block], places: Mapping[Path, str]) -> str:
    """The page as Markdown.

    Args:
      blocks: of the page.
      places: links to the figures, by their paths.
    """
    parts = []
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"{'#' * level} {text}")
            case Paragraph(text):
                parts.append(text)
            case Items(texts):
                parts.append("\n".join(f"* {text}" for text in texts))
            case Figure(path, caption):
                parts.append(f"![{caption}]({places[path]})\n\n{caption}")
            case Table(heads, rows):
                parts.append(format_table(heads, rows).rstrip("\n"))
    return "\n\n".join(parts) + "\n"


def write_html(blocks: Sequence[Block], title: str) -> str:
    """The page as one HTML file with its figures inside."""
    body = "\n".join(map(_write_block, blocks))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body>{body}</body></html>\n"
    )


def _write_block(block: Block) -> str:
    match block:
        case Heading(text, level):
            return f"<h{level}>{html.escape(text)}</h{level}>"
        case Paragraph(text):
            return f"<p>{html.escape(text)}</p>"
        case Items(texts):
            items = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
            return f"<ul>{items}</ul>"
        case Figure(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            kind, text = _TYPES[path.suffix], html.escape(caption)
            image = f'<img alt="{text}" src="data:{kind};base64,{data}">'
            return f"<figure>{image}<figcaption>{text}</figcaption></figure>"
        case Table(heads, rows):
            return _write_table(heads, rows)


def _write_table(heads, rows) -> str:
    """Rows of a new first cell stand apart."""
    lines = ["".join(f"<th>{html.escape(head)}</th>" for head in heads)]
    text = f"<tr>{lines[0]}</tr>"
    before = None
    for row in rows:
        kind = ' class="first"' if row[0] != before else ""
        before = row[0]
        cells = "".join(map(_write_cell, row))
        text += f"<tr{kind}>{cells}</tr>"
    return f'<div class="wide"><table>{text}</table></div>'


def _write_cell(cell: str) -> str:
    first = cell[:1]
    if cell in ("met", "not met"):
        return f'<td class="{"yes" if cell == "met" else "no"}">{cell}</td>'
    kind = ' class="n"' if first.isdigit() or first in "–-" and first else ""
    return f"<td{kind}>{html.escape(cell)}</td>"
