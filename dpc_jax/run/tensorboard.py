"""The log of a run that TensorBoard shows too, by event files of tensorboardX.

A run that goes on after a kill trains some steps again. So each start writes the whole
history anew, from `metrics.jsonl` and from the pictures of the files that are there:
any reader finds each step once.
"""

import math
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tensorboardX import summary
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import (
    Event,  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
)

from dpc_jax.data import DataSet
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.training.records import MetricLog

PICTURE = "validation/input_target_predicted"  # its name in TensorBoard
_VIEWS = 8  # in a picture
_SIDE = 64  # of a tile at least, pixels
_MARGIN = ((1, 1), (1, 1), (0, 0))  # grey pixels around a tile
_HEAD = struct.Struct("<QI")  # length of an event, and its check sum
_TAIL = 4  # bytes of the check sum after it
_FLUSH_SECONDS = 5.0  # between two, each of which waits for the disk


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
        self._writer: EventsWriter | None = None
        self._origin, self._seconds, self._flushed = time.time(), 0.0, 0.0

    def write(self, record: dict):
        """Append one record; a kill may lose its events until the run goes on.

        Raises:
          OSError: where the disk is full.
        """
        super().write(record)
        self._add_record(record)
        if time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self._flush()

    def cut_after(self, step: int):
        """Drop the records after a step, and write the events of the others anew."""
        super().cut_after(step)
        records = self.read()
        self._folder.mkdir(parents=True, exist_ok=True)
        old = sorted(self._folder.glob("events.out.tfevents.*"))
        pictures = {
            event.step: event
            for path in old
            for event in read_events(path)
            if any(value.HasField("image") for value in event.summary.value)
        }
        self._origin = time.time() - (records[-1]["seconds"] if records else 0.0)
        # The name is the time in whole seconds: two starts may share it.
        self._writer = EventsWriter(
            str(self._folder / "events"), filename_suffix=f".{time.time_ns()}"
        )
        for record in records:
            self._add_record(record)
            if event := pictures.pop(record["step"], None):
                self._add(event.summary, event.step)
        self._flush()
        for path in old:
            path.unlink()

    def show_validation(self, step: int, predictions: Predictions, dataset: DataSet):
        """Show some views of a validation."""
        picture = draw_validation(predictions, dataset)
        self._add(summary.image(PICTURE, picture, dataformats="HWC"), step)
        self._flush()

    def close(self):
        """Close the event file."""
        if self._writer is not None:
            self._writer.close()

    def _flush(self):
        assert self._writer is not None  # `cut_after` comes first
        self._writer.flush()
        self._flushed = time.monotonic()

    def _add_record(self, record):
        """Its finite numbers by name; its shares as histograms, a bar for each."""
        self._seconds, step = record["seconds"], record["step"]
        for name, value in record.items():
            if isinstance(value, list):
                self._add(_make_histogram(name, value), step)
            elif isinstance(value, int | float) and math.isfinite(value):
                if name != "step":
                    self._add(summary.scalar(name, float(value)), step)

    def _add(self, content, step):
        event = Event(
            wall_time=self._origin + self._seconds, step=step, summary=content
        )
        assert self._writer is not None
        self._writer.write_event(event)


def _make_histogram(name: str, shares: list[float]):
    """Shares [K] that sum to 1, as a bar for each whole number below K."""
    places = np.arange(len(shares))
    return summary.histogram_raw(
        name,
        min=-0.5,
        max=len(shares) - 0.5,
        num=1.0,
        sum=float(places @ shares),
        sum_squares=float(places**2 @ shares),
        bucket_limits=(places + 0.5).tolist(),
        bucket_counts=shares,
    )


def read_events(path: Path) -> Iterator[Event]:
    """The events of a file; a last one cut off by a kill is passed over."""
    data, place = path.read_bytes(), 0
    while place + _HEAD.size <= len(data):
        length, _ = _HEAD.unpack_from(data, place)
        start = place + _HEAD.size
        place = start + length + _TAIL
        if place <= len(data):
            yield Event.FromString(data[start : start + length])


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
