"""The log of a run that trackers are told of: TensorBoard, Weights & Biases."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from dpc_jax.config import Config
from dpc_jax.learning.training.records import MetricLog


class Tracker(Protocol):
    """A tool that shows a run while it trains."""

    def begin(self, records: Sequence[dict]):
        """Take up a run that has these records; what lies after them is trained again.

        Called before anything else, at each start of the run.
        """

    def write(self, record: dict):
        """Take one record of `metrics.jsonl`."""

    def show(self, step: int, picture: np.ndarray):
        """Take the picture uint8 [H, W, 3] of a validation."""

    def close(self):
        """Write what is left; no call comes after."""


class TrackedLog(MetricLog):
    """`metrics.jsonl`, which stays the record, and trackers that are told the same."""

    def __init__(self, path: Path, trackers: Sequence[Tracker]):
        super().__init__(path)
        self._trackers = trackers

    def write(self, record: dict):
        """Append one record, then tell the trackers.

        Raises:
          OSError: where the disk is full.
        """
        super().write(record)
        for tracker in self._trackers:
            tracker.write(record)

    def cut_after(self, step: int):
        """Drop the records after a step, and have the trackers go on from there."""
        super().cut_after(step)
        kept = self.read()
        for tracker in self._trackers:
            tracker.begin(kept)

    def show(self, step: int, picture: np.ndarray):
        """Show the picture uint8 [H, W, 3] of a validation."""
        for tracker in self._trackers:
            tracker.show(step, picture)

    def close(self):
        """Close the trackers."""
        for tracker in self._trackers:
            tracker.close()


# Field of `Log` that asks for a tracker: its package, and the extra to install.
_PACKAGES = {"tensorboard": ("tensorboardX", "tensorboard"), "wandb": ("wandb",) * 2}


def check_trackers(config: Config):
    """Check that the packages of the trackers asked for are there.

    Raises:
      ValueError: naming the one that is not, and how to install it.
    """
    for field, (package, extra) in _PACKAGES.items():
        value = getattr(config.log, field)
        if value and importlib.util.find_spec(package) is None:
            raise ValueError(
                f"config.log.{field} must be left out where {package} is not "
                f"installed, but it is {value!r}; install it with pip install "
                f"'dpc_jax[{extra}]', or leave the flag out."
            )


def open_log(workdir: Path, config: Config) -> MetricLog:
    """The log of a run, tracked where the config asks for it; to be closed if tracked.

    A tracker's package is imported here, and only if it is asked for.
    """
    path = workdir / "metrics.jsonl"
    trackers: list[Tracker] = []
    if config.log.tensorboard:
        from dpc_jax.run.trackers.tensorboard_files import TensorBoardFiles

        trackers.append(TensorBoardFiles(workdir / "tensorboard"))
    if config.log.wandb:
        from dpc_jax.run.trackers.wandb_run import WandbRun

        trackers.append(WandbRun(workdir, config))
    return TrackedLog(path, trackers) if trackers else MetricLog(path)
