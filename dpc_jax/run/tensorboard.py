"""The log of a run that TensorBoard shows too, by event files of tensorboardX."""

import math
import time
from pathlib import Path

from tensorboardX import SummaryWriter

from dpc_jax.learning.training.records import MetricLog


class TensorBoardLog(MetricLog):
    """`metrics.jsonl`, which stays the record, and a folder for `tensorboard --logdir`.

    Each start writes the events of all records anew: steps that a kill has made stale
    are in neither. The time of an event counts seconds of training, so that the axis
    "relative" is the run time of the report's curves.

    Args:
      path: of `metrics.jsonl`.
      folder: of the event files, made where there is none.
    """

    def __init__(self, path: Path, folder: Path):
        super().__init__(path)
        self._folder, self._writer = folder, None

    def write(self, record: dict):
        """Append one record; OSError where the disk is full."""
        super().write(record)
        self._add_record(record)

    def cut_after(self, step: int):
        """Drop the records after a step, and begin the event files with the others."""
        super().cut_after(step)
        for path in self._folder.glob("events.*"):
            path.unlink()
        # A TensorBoard that has read the files before forgets their steps.
        self._writer = SummaryWriter(str(self._folder), purge_step=0)
        records = self.read()
        self._started = time.time() - (records[-1]["seconds"] if records else 0.0)
        for record in records:
            self._add_record(record)

    def close(self):
        """Close the event file."""
        if self._writer is not None:
            self._writer.close()

    def _add_record(self, record):
        """Its finite numbers, by name."""
        assert self._writer is not None, "cut_after comes first"
        when = self._started + record["seconds"]
        for name, value in record.items():
            is_number = isinstance(value, int | float) and math.isfinite(value)
            if is_number and name != "step":
                self._writer.add_scalar(name, float(value), record["step"], when)
        self._writer.flush()
