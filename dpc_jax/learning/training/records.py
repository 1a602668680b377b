"""What a run records of its steps, whether they are finite, and the file it goes to."""

import contextlib
import functools
import json
import math
import os
import time
from pathlib import Path

import jax
import numpy as np

from dpc_jax.files import (
    explaining_full_disk,
    open_regular,
    write_text,
)

_NOT_LOSSES = ("winners", "gradient_norms")
# A loss so many times that of the first step means that training is lost (heuristic).
# The comparison of images is bounded, and a step of a default run is never above its
# first; what grows without bound are the penalties of parameters and points that leave.
_DIVERGED = 100.0
_LEAST = 1.0  # of the first loss, for this comparison: some losses begin near 0


class NonFiniteError(RuntimeError):
    """Training met a loss or gradient that is not finite, or a loss that grows."""


class Window:
    """The steps since the last record; their losses are checked by `check_step`.

    Args:
      step: steps done before the first one. seconds: of training until then, over all
        starts of a run.
      heads: K, whose shares of the winners are recorded; 0 where poses are known.
    """

    def __init__(self, step: int, seconds: float, *, heads: int):
        self._heads = heads
        self._first: float | None = None  # loss
        self.set_clock(seconds)
        self._open(step, seconds)

    def _open(self, step, seconds):
        self._step, self._seconds, self._waited = step, seconds, 0.0
        self._metrics: list[dict] = []

    @property
    def seconds(self) -> float:
        """Of training until now."""
        return time.monotonic() - self._started

    def set_clock(self, seconds: float):
        """Set the clock, as after a validation, which is no training."""
        self._started = time.monotonic() - seconds

    @property
    def is_empty(self) -> bool:
        """Whether no step was added."""
        return not self._metrics

    def add(self, metrics: dict):
        """Take the metrics of one more step, and check those of the step before.

        That step has finished while this one runs: reading its metrics is free.
        """
        self.check()
        self._metrics.append(metrics)

    def add_waiting(self, seconds: float):
        """Count seconds until now as compilation, not as those of steps."""
        self._waited += seconds

    def check(self):
        """Check the last step too."""
        if self._metrics:
            metrics = self._metrics[-1]
            check_step(metrics, self._step + len(self._metrics) - 1, first=self._first)
            if self._first is None:
                self._first = float(metrics["loss"])

    def close(self) -> dict:
        """The record of the window; a new window starts.

        Its `seconds` are all that training has taken so far; where some of the window
        were waited for compilation they are its `compile_seconds`, and
        `steps_per_second` does without them.
        """
        self.check()
        seconds, done = self.seconds, self._step + len(self._metrics)
        stepping = seconds - self._seconds - self._waited
        rate = len(self._metrics) / max(stepping, 1e-9)
        record = {"step": done, "seconds": round(seconds, 3)}
        record |= summarize(self._metrics, heads=self._heads)
        record["steps_per_second"] = round(rate, 3)
        if self._waited > 0.01:  # less is the look at whether there is something to do
            record["compile_seconds"] = round(self._waited, 3)
        self._open(done, seconds)
        return record


def check_step(metrics: dict, step: int, *, first: float | None):
    """Raise where a loss or gradient is not finite, or the loss far above the first.

    Raises:
      NonFiniteError: with the step (counted from 0) and the first culprit's name.
    """
    losses = [name for name in metrics if name not in _NOT_LOSSES]
    values = {f"{n} loss": metrics[n] for n in sorted(losses, key="loss".__eq__)}
    for name, norm in metrics["gradient_norms"].items():
        values[f"gradient of the {name} parameters"] = norm
    for name, value in values.items():
        if not np.isfinite(value):
            raise NonFiniteError(
                f"Expected finite losses and gradients, but the {name} became "
                f"{float(value)} at step {step}; start a run in another workdir with a "
                "lower train.learning_rate. Checkpoints saved until then stay."
            )
    loss = float(metrics["loss"])
    if first is not None and abs(loss) > _DIVERGED * max(abs(first), _LEAST):
        raise NonFiniteError(
            f"Expected a loss that falls, but training diverged: the loss grew from "
            f"{first:.3g} to {loss:.3g} at step {step}; start a run in another workdir "
            "with a lower train.learning_rate. Checkpoints saved until then stay."
        )


def summarize(window: list[dict], *, heads: int) -> dict:
    """Means over the steps of a window, and how often each of K heads won.

    A loss that a stage does not have is averaged over the steps that have it.
    """
    window = jax.device_get(window)
    losses: dict[str, list] = {}
    for metrics in window:
        for name in metrics.keys() - set(_NOT_LOSSES):
            losses.setdefault(name, []).append(metrics[name])
    record: dict = {n: float(np.mean(found)) for n, found in sorted(losses.items())}
    for name in window[0]["gradient_norms"]:
        norms = [m["gradient_norms"][name] for m in window]
        measured = [norm for norm in norms if norm >= 0]
        if measured:
            record[f"gradient_norm_{name}"] = float(np.mean(measured))
    if heads > 1:
        winners = np.concatenate([m["winners"] for m in window]) % heads
        counts = np.bincount(winners, minlength=heads)
        record["head_shares"] = [round(float(c), 4) for c in counts / counts.sum()]
    return record


class MetricLog:
    """`metrics.jsonl` of a run; each record has at least `step` and `seconds`.

    Without a path, as in all processes of a job but the first, nothing is kept.
    """

    def __init__(self, path: str | os.PathLike | None):
        self._path = None if path is None else Path(path)

    def write(self, record: dict):
        """Append one record; it is on disk when this returns.

        Raises:
          OSError: where the disk is full.
        """
        if self._path is None:
            return
        with (
            explaining_full_disk(self._path.parent),
            open(self._path, "a", encoding="utf-8") as file,
        ):
            file.write(json.dumps(record) + "\n")

    def read(self) -> list[dict]:
        """All records; a line that is none, as one cut by a kill, is passed over."""
        records = []
        if self._path and self._path.exists():
            with open_regular(self._path) as file:
                text = file.read().decode("utf-8", "replace")
            for line in text.splitlines():
                # Too deep for Python's parser is no record either.
                with contextlib.suppress(ValueError, RecursionError):
                    records.append(json.loads(line))
        return [
            record
            for record in records
            if isinstance(record, dict)
            and isinstance(record.get("step", 0), int | float)
        ]

    def cut_after(self, step: int):
        """Drop the records after a step: a resumed run writes them again."""
        if self._path and self._path.exists():
            kept = [r for r in self.read() if r["step"] <= step]
            write_text(self._path, "".join(json.dumps(r) + "\n" for r in kept))

    def close(self):
        """Do nothing: each record is on disk already."""


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
        from tensorboardX import SummaryWriter  # only where asked for

        super().__init__(path)
        self._folder, self._writer = folder, None
        # A TensorBoard that has read the files before forgets their steps.
        self._open = functools.partial(SummaryWriter, str(folder), purge_step=0)

    def write(self, record: dict):
        """Append one record; OSError where the disk is full."""
        super().write(record)
        self._add_record(record)

    def cut_after(self, step: int):
        """Drop the records after a step, and begin the event files with the others."""
        super().cut_after(step)
        for path in self._folder.glob("events.*"):
            path.unlink()
        self._writer = self._open()
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
