"""Rendered images beside those of the data: silhouette, depth and colour."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy.typing import ArrayLike

from dpc_jax.evaluation.images import ViewImages
from dpc_jax.reporting import style
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_grid

_EMPTY = (0.93, 0.945, 0.957)  # the background of depths, pale grey
_SIGNED = Normalize(-1.0, 1.0)
_DEPTH_DIFFERENCE = 0.25  # box diagonals at the ends of the scale


def draw_signals(examples: Sequence[Example], path: str | os.PathLike) -> Path:
    """A grid of images, a row per example, after its input three for each signal.

    These are the target, the render from the predicted pose, and their difference. Of
    silhouettes and depths it is signed: red where the render is too large or too far,
    blue where it is too small or too near. Depths are on one scale for all rows, the
    near ones bright; the background is grey. The difference of colours is their
    distance, black for none.

    Args:
      examples: at least one, all with images of the same signals.
    """
    every = [example.images for example in examples if example.images]
    depths, titles = _find_depths(every), ["input"]
    for name in every[0].rendered:
        titles += [name, "rendered", "difference"]
    rows = [[example.image] for example in examples]
    for row, images in zip(rows, every, strict=True):
        for name in images.rendered:
            row += _list_pictures(name, images, depths)
    labels = [style.spell_name(example.name) for example in examples]
    return draw_grid(rows, path, titles=titles, labels=labels, size=1.2)


def _find_depths(every: Sequence[ViewImages]):
    """A scale from the smallest to the largest depth of what the true masks cover."""
    targets = [images.targets for images in every if "depth" in images.targets]
    found = [t["depth"][t["silhouette"] >= 0.5] for t in targets]
    values = np.concatenate([*found, np.zeros(0)])
    return Normalize(values.min(), values.max()) if values.size else Normalize(1.5, 2.5)


def _list_pictures(name: str, images: ViewImages, depths: Normalize):
    """Target, render and difference of a signal."""
    target, rendered = images.targets[name], images.rendered[name]
    away = rendered - target
    if name == "silhouette":
        return target, rendered, _paint("RdBu_r", _SIGNED(away))
    if name == "color":
        distance = np.sqrt(np.mean(away**2, axis=-1))
        return np.clip(target, 0, 1), np.clip(rendered, 0, 1), 2 * distance
    outside, missed = (
        one["silhouette"] < 0.5 for one in (images.targets, images.rendered)
    )
    signed = _SIGNED(away / _DEPTH_DIFFERENCE)
    return (
        _paint("viridis_r", depths(target), outside),
        _paint("viridis_r", depths(rendered), missed),
        _paint("RdBu_r", signed, outside),
    )


def _paint(colors: str, shares, is_empty: ArrayLike = False) -> np.ndarray:
    """Shares of a scale of colours [S, S] as [S, S, 3]."""
    painted = colormaps[colors](shares)[..., :3]
    return np.where(np.expand_dims(is_empty, -1), _EMPTY, painted)
