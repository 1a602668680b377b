"""The log of a run that TensorBoard shows too, by event files of tensorboardX.

A run that goes on after a kill trains some steps again. Each start writes a file of its
own, which begins by having TensorBoard drop those steps from the files before.
"""

import math
import time
from pathlib import Path

import numpy as np
from tensorboardX import SummaryWriter

from dpc_jax.data import DataSet
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.training.records import MetricLog

PICTURE = "validation/input_target_predicted"  # its name in TensorBoard
_VIEWS = 8  # in a picture
_SIDE = 64  # of a tile at least, pixels
_MARGIN = ((1, 1), (1, 1), (0, 0))  # grey pixels around a tile


class TensorBoardLog(MetricLog):
    """`metrics.jsonl`, which stays the record, and a folder for `tensorboard --logdir`.

    The time of an event counts seconds of training from the first start, so that the
    axis "relative" is the run time of the report's curves.

    Args:
      path: of `metrics.jsonl`.
      folder: of the event files, made where there is none.
    """

    def __init__(self, path: Path, folder: Path):
        super().__init__(path)
        self._folder = folder
        self._writer: SummaryWriter | None = None  # `cut_after` comes first
        self._origin = self._seconds = 0.0

    def write(self, record: dict):
        """Append one record.

        Raises:
          OSError: where the disk is full.
        """
        super().write(record)
        self._add_record(record)

    def cut_after(self, step: int):
        """Drop the records after a step, and have TensorBoard drop their events."""
        super().cut_after(step)
        records = self.read()
        self._seconds = records[-1]["seconds"] if records else 0.0
        old = sorted(self._folder.glob("events.*"))
        origin = time.time_ns() - int(1e9 * self._seconds)
        if old:  # whose names end with it
            origin = int(old[0].suffix[1:])
        self._origin = origin / 1e9
        self._writer = SummaryWriter(
            str(self._folder),
            purge_step=step + 1,
            # The rest of the name is the time in whole seconds: two may share it.
            filename_suffix=f".{len(old)}.{origin}",
        )
        for record in [] if old else records:
            self._add_record(record)

    def show_validation(self, step: int, predictions: Predictions, dataset: DataSet):
        """Show some views of a validation."""
        assert self._writer is not None
        picture, when = draw_validation(predictions, dataset), self._when
        self._writer.add_image(PICTURE, picture, step, when, dataformats="HWC")
        self._writer.flush()

    def close(self):
        """Close the event file."""
        if self._writer is not None:
            self._writer.close()

    @property
    def _when(self):
        return self._origin + self._seconds

    def _add_record(self, record):
        """Its finite numbers by name; its shares as histograms, a bar for each."""
        writer, step, self._seconds = self._writer, record["step"], record["seconds"]
        assert writer is not None
        for name, value in record.items():
            if isinstance(value, list):
                places = np.arange(len(value))  # shares [K], which sum to 1
                writer.add_histogram_raw(
                    name,
                    min=-0.5,
                    max=len(value) - 0.5,
                    num=1,
                    sum=float(places @ value),
                    sum_squares=float(places**2 @ value),
                    bucket_limits=(places + 0.5).tolist(),
                    bucket_counts=value,
                    global_step=step,
                    walltime=self._when,
                )
            elif isinstance(value, int | float) and math.isfinite(value):
                if name != "step":
                    writer.add_scalar(name, float(value), step, self._when)
        writer.flush()


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
        column = []
        for tile in tiles:
            rows = np.arange(side) * len(tile) // side  # pixels stay squares
            tile = np.atleast_3d(tile)[rows][:, rows]
            tile = np.broadcast_to(tile, (side, side, 3))
            column.append(np.pad(tile, _MARGIN, constant_values=128))
        columns.append(np.concatenate(column))
    return np.concatenate(columns, axis=1)
