"""Event files that TensorBoard reads, written by tensorboardX.

A run that goes on after a kill trains some steps again. So each start writes the whole
history anew, from `metrics.jsonl` and from the pictures of the files before: any reader
finds each step once, not only TensorBoard, which hides what comes twice.
"""

import struct
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from tensorboardX import summary
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import (
    Event,  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
)

from dpc_jax.run.trackers.content import PICTURE, list_histograms, list_scalars

_HEAD = struct.Struct("<QI")  # length of an event, and its check sum
_TAIL = 4  # bytes of the check sum after it
_FLUSH_SECONDS = 5.0  # between two, each of which waits for the disk


class TensorBoardFiles:
    """A `Tracker` that writes a folder for `tensorboard --logdir`.

    The time of an event counts seconds of training from the first start, so that the
    axis "relative" is the run time of the report's curves.

    Args:
      folder: made where there is none.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._writer: EventsWriter | None = None
        self._origin, self._seconds, self._flushed = time.time(), 0.0, 0.0

    def begin(self, records: Sequence[dict]):
        """Write the history anew: the records, and the pictures of their steps."""
        self._folder.mkdir(parents=True, exist_ok=True)
        before = sorted(self._folder.glob("events.out.tfevents.*"))
        shown = {
            e.step: e for path in before for e in read_events(path) if _is_shown(e)
        }
        self._origin = time.time() - (records[-1]["seconds"] if records else 0.0)
        # The name is the time in whole seconds: two starts may share it.
        self._writer = EventsWriter(
            str(self._folder / "events"), filename_suffix=f".{time.time_ns()}"
        )
        for record in records:
            self._add_record(record)
            if event := shown.pop(record["step"], None):
                self._add(event.summary, event.step)
        self._flush()
        for path in before:
            path.unlink()

    def write(self, record: dict):
        """Take one record; a kill may lose the last ones until the run goes on."""
        self._add_record(record)
        if time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self._flush()

    def show(self, step: int, picture: np.ndarray):
        """Take the picture of a validation."""
        self._add(summary.image(PICTURE, picture, dataformats="HWC"), step)
        self._flush()

    def close(self):
        """Close the file."""
        if self._writer is not None:
            self._writer.close()

    def _flush(self):
        self._get_writer().flush()
        self._flushed = time.monotonic()

    def _get_writer(self) -> EventsWriter:
        assert self._writer is not None  # `begin` comes first
        return self._writer

    def _add_record(self, record):
        self._seconds = record["seconds"]
        step = record["step"]
        for name, value in list_scalars(record).items():
            self._add(summary.scalar(name, value), step)
        for name, (shares, edges) in list_histograms(record).items():
            places = np.arange(len(shares))
            text = summary.histogram_raw(
                name,
                min=edges[0],
                max=edges[-1],
                num=1.0,
                sum=float(places @ shares),
                sum_squares=float(places**2 @ shares),
                bucket_limits=edges[1:],
                bucket_counts=shares,
            )
            self._add(text, step)

    def _add(self, content, step):
        event = Event(
            wall_time=self._origin + self._seconds, step=step, summary=content
        )
        self._get_writer().write_event(event)


def read_events(path: Path) -> Iterator[Event]:
    """The events of a file; a last one cut off by a kill is passed over."""
    data, place = path.read_bytes(), 0
    while place + _HEAD.size <= len(data):
        length, _ = _HEAD.unpack_from(data, place)
        start = place + _HEAD.size
        place = start + length + _TAIL
        if place <= len(data):
            yield Event.FromString(data[start : start + length])


def _is_shown(event: Event) -> bool:
    return any(value.HasField("image") for value in event.summary.value)
