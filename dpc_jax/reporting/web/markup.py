"""Pieces of HTML: the page, charts and pictures that lie inside it."""

import base64
import html
import io
from importlib import resources
from pathlib import Path

import numpy as np
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
        with Image.open(path) as picture:
            source, kind = _pack(picture.convert("RGB")), ""
    else:
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        form = "svg+xml" if path.suffix == ".svg" else "png"
        source, kind = f"data:image/{form};base64,{data}", ' class="chart"'
    title = html.escape(title)
    return f'<div class="wide"><img{kind} alt="{title}" src="{source}"></div>\n'


def embed_picture(picture: np.ndarray, title: str, caption: str = "") -> str:
    """A picture uint8 [H, W, 3 or 4] with a caption that is HTML."""
    source = _pack(Image.fromarray(picture))
    height, width = picture.shape[:2]
    title = html.escape(title)
    return (
        f'<figure><img alt="{title}" width="{width}" height="{height}" loading="lazy" '
        f'src="{source}"><figcaption>{title}{caption}</figcaption></figure>'
    )


def _pack(picture: Image.Image) -> str:
    """A picture as a source of `img`: WebP, which can be clear."""
    buffer = io.BytesIO()
    picture.save(buffer, format="WEBP", quality=82, method=4)
    return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode()}"
