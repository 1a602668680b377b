"""Test views one by one: input, silhouettes, and shaded pictures of the shapes."""

import html
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.evaluation.metrics import format_metric
from dpc_jax.reporting.clouds import FRONT, REAR, draw_cloud
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_difference
from dpc_jax.reporting.web.markup import embed_picture

_SIDE = 400  # pixels of a picture
_SHOWN = 3000  # points of a true shape
_PREDICTED, _OTHER = (0.22, 0.50, 0.75), (0.62, 0.66, 0.70)


def show_examples(examples: Sequence[Example]) -> str:
    """A card for each example, under the headings of their groups."""
    text, numbered = "", enumerate(examples)
    for group, members in itertools.groupby(numbered, lambda pair: pair[1].group):
        text += f"<h3>{html.escape(group)}</h3>" if group else ""
        text += "".join(_show_example(example, index) for index, example in members)
    return text


def _show_example(example: Example, index: int) -> str:
    pair = embed_picture(np.asarray(example.image), "Input")
    about = "Silhouettes: red too much, blue missing"
    pair += embed_picture(draw_difference(example), about)
    pictures = f'<div class="pair">{pair}</div>'
    cloud = example.points
    colors = _PREDICTED if example.colors is None else example.colors
    note = _note_chamfer(example.chamfer)
    pictures += _picture(cloud, colors, FRONT, "Predicted", note)
    if example.surface is None:
        pictures += _picture(cloud, colors, REAR, "Predicted, from behind")
    else:
        surface = np.asarray(example.surface)
        rows = np.linspace(0, len(surface) - 1, min(_SHOWN, len(surface))).astype(int)
        pictures += _picture(surface[rows], _OTHER, FRONT, "True")
    for near in example.neighbours:
        note = _note_chamfer(near.chamfer)
        pictures += _picture(near.points, _OTHER, FRONT, near.title, note)
    found = (
        ("pose error", "pose_median_error_deg", example.pose_error_deg, "°"),
        ("Chamfer distance", "chamfer", example.chamfer, ""),
        ("silhouette overlap", "silhouette_iou", example.overlap, " %"),
    )
    facts = " · ".join(
        f"{label} {format_metric(metric, value)}{unit}"
        for label, metric, value, unit in found
        if value is not None
    )
    return (
        f'<article class="card"><header><b>{html.escape(example.name)}</b>'
        f'<span class="hint">{facts}</span>'
        f'<button data-turn="{index}">Turn it</button></header>'
        f'<div class="pictures">{pictures}</div></article>\n'
    )


def _note_chamfer(value: float | None) -> str:
    return "" if value is None else f": {format_metric('chamfer', value)}"


def _picture(
    points: ArrayLike,
    colors: ArrayLike,
    view_deg: tuple[float, float],
    title: str,
    note: str = "",
) -> str:
    drawn = draw_cloud(points, colors, view_deg=view_deg, size=_SIDE, is_clear=True)
    return embed_picture(drawn, title, note)
