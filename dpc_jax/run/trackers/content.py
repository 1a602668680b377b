"""What trackers are told: numbers and shares of a record, pictures of validations."""

import math
from typing import NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.learning.inference.predictor import Predictions, arrange_views

PICTURE = "validation/input_target_predicted"  # its name in the tools
_VIEWS = 8  # in a picture
_SIDE = 64  # of a tile at least, pixels
_GAP = 2  # pixels between tiles


class Histogram(NamedTuple):
    """Shares [K] that sum to 1, of the bars between K + 1 edges."""

    shares: list[float]
    edges: list[float]


def list_scalars(record: dict) -> dict[str, float]:
    """The numbers of a record by their names in `metrics.jsonl`."""
    return {
        name: float(value)
        for name, value in record.items()
        if name != "step" and isinstance(value, int | float) and math.isfinite(value)
    }


def list_histograms(record: dict) -> dict[str, Histogram]:
    """The shares of a record, as how often each candidate won, a bar for each."""
    return {
        name: Histogram(value, [i - 0.5 for i in range(len(value) + 1)])
        for name, value in record.items()
        if isinstance(value, list)
    }


def draw_validation(predictions: Predictions, dataset: DataSet) -> np.ndarray:
    """Views of models spread over the set, side by side, as uint8 [H, W, 3].

    The rows are the inputs, the true silhouettes and the predicted ones.
    """
    models, views = arrange_views(dataset)
    chosen = np.linspace(0, len(models) - 1, min(_VIEWS, len(models))).astype(int)
    columns = []
    for row in chosen:
        place = models[row, 0], views[row, 0]
        predicted = np.clip(predictions.silhouettes[row, 0], 0.0, 1.0)
        tiles = (
            np.asarray(dataset.images[place]),
            np.asarray(dataset.masks[place]),
            np.round(255 * predicted).astype(np.uint8),
        )
        side = max(_SIDE, len(tiles[0]))
        columns.append(_join([_enlarge(tile, side) for tile in tiles], axis=0))
    return _join(columns, axis=1)


def _enlarge(tile: np.ndarray, side: int) -> np.ndarray:
    """A square picture, grey or in colours, as [side, side, 3]; pixels stay squares."""
    rows = np.arange(side) * len(tile) // side
    if tile.ndim == 2:
        tile = np.repeat(tile[..., None], 3, axis=-1)
    return tile[rows][:, rows]


def _join(pictures: list[np.ndarray], *, axis: int) -> np.ndarray:
    """Pictures in a row or column, with gaps between."""
    shape = list(pictures[0].shape)
    shape[axis] = _GAP
    gap = np.full(shape, 128, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    return np.concatenate(parts, axis=axis)
