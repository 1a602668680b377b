"""Pieces of HTML: the page, and charts that lie inside it."""

import base64
import html
import io
from importlib import resources
from pathlib import Path

from PIL import Image


def read_asset(name: str) -> str:
    """The text of a style sheet or script of this folder."""
    folder = resources.files("dpc_jax.reporting.web")
    return folder.joinpath(name).read_text(encoding="utf-8")


def assemble_page(title: str, body: str, *, style: str = "") -> str:
    """A page that needs nothing beside it.

    Args:
      title: of the window; the headings are in the body.
      body: HTML. style: rules after those of all pages.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title>"
        f"<style>{read_asset('page.css')}{style}</style></head>\n"
        f"<body>{body}</body></html>\n"
    )


def embed_chart(path: Path, title: str, *, is_photo: bool) -> str:
    """A PNG or SVG in the page; on a phone it scrolls sideways, or its print is lost.

    Args:
      title: for those who cannot see it.
      is_photo: whether it has images, which stay as they are in dark mode; as WebP
        they take a tenth of the bytes.
    """
    if is_photo:
        buffer = io.BytesIO()
        with Image.open(path) as picture:
            picture.convert("RGB").save(buffer, format="WEBP", quality=82, method=4)
        data, form, kind = buffer.getvalue(), "webp", ""
    else:
        form = "svg+xml" if path.suffix == ".svg" else "png"
        data, kind = path.read_bytes(), ' class="chart"'
    source = f"data:image/{form};base64,{base64.b64encode(data).decode()}"
    alt = html.escape(title)
    return f'<div class="wide"><img{kind} alt="{alt}" src="{source}"></div>\n'
