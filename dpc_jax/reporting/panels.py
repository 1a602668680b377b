"""Pictures of equal size in a labelled grid, or one after another in an animation."""

import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax.files import write_bytes
from dpc_jax.reporting.style import (
    INK,
    make_panels,
    make_table_of_pictures,
    save_figure,
)

_SIDE = 1.9  # of a panel, inches


def draw_grid(
    rows: Sequence[Sequence[np.ndarray | None]],
    path: str | os.PathLike,
    *,
    titles: Sequence[str] = (),
    framed: int = 0,
) -> Path:
    """Write pictures uint8 [S, S, 3] as a grid; None leaves a place empty.

    Args:
      rows: of pictures, all of one length.
      titles: of the columns.
      framed: how many pictures of the first row get a dark frame.

    Raises:
      ValueError: there are no pictures.
    """
    if not rows or not rows[0]:
        raise ValueError(
            "rows must hold at least one picture, but there are none; pass pictures."
        )
    columns = len(rows[0])
    height = 1.02 * _SIDE * len(rows) + (0.3 if titles else 0.05)
    figure = make_table_of_pictures(_SIDE * columns, height)
    panels = make_panels(figure, len(rows) * columns, columns=columns)
    for place, axes in enumerate(panels):
        picture = rows[place // columns][place % columns]
        if picture is None:
            axes.set_axis_off()
            continue
        axes.imshow(picture)
        axes.set(xticks=[], yticks=[])
        for spine in axes.spines.values():
            spine.set_color(INK if place < framed else "#d5dbe1")
            spine.set_linewidth(2.2 if place < framed else 0.8)
    for axes, title in zip(panels, titles, strict=False):
        axes.set_title(title, fontsize=10, color=INK)
    return _shrink(save_figure(figure, path))


def _shrink(path: Path) -> Path:
    """The picture with 256 colours: a third of the bytes, hardly a difference."""
    buffer = io.BytesIO()
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE).save(
            buffer, format="PNG", optimize=True
        )
    return write_bytes(path, buffer.getvalue())


def write_animation(
    frames: Sequence[np.ndarray],
    path: str | os.PathLike,
    *,
    milliseconds: Sequence[int] | int = 80,
) -> Path:
    """Write frames uint8 [H, W, 3] as an endless GIF or WebP, by the path's suffix.

    All frames of a GIF share 128 colours: what does not change does not flicker.

    Args:
      milliseconds: that each frame stays, or all of them.

    Raises:
      ValueError: there are no frames.
    """
    if not frames:
        raise ValueError(
            "frames must be at least one, but there are none; pass pictures."
        )
    kind = Path(path).suffix[1:].upper()
    pictures = [Image.fromarray(frame) for frame in frames]
    if kind == "GIF":
        spread = frames[:: 1 + len(frames) // 12]
        sample = Image.fromarray(np.concatenate([f[::2, ::2] for f in spread]))
        palette = sample.quantize(128, method=Image.Quantize.MAXCOVERAGE)
        pictures = [
            p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures
        ]
    times = milliseconds if isinstance(milliseconds, int) else list(milliseconds)
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format=kind,
        save_all=True,
        append_images=pictures[1:],
        duration=times,
        loop=0,
        optimize=False,
    )
    return write_bytes(path, buffer.getvalue())
