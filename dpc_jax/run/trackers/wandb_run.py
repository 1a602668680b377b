"""A run of Weights & Biases, kept in the workdir or sent while it trains.

Its steps can only grow. A run that goes on after a kill trains some steps again, with
the same results, and these are not told twice.
"""

import json
import os
import re
import secrets
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import wandb

from dpc_jax.config import Config
from dpc_jax.files import write_json
from dpc_jax.run.trackers.content import PICTURE, list_histograms, list_scalars


class WandbRun:
    """A `Tracker` that logs a row for each step.

    All starts of a run share one id, kept in WORKDIR/wandb. The project is dpc_jax, or
    that of WANDB_PROJECT; seeds of one config form a group.

    Args:
      workdir: of the run. config: sent along; `log.wandb` is "offline" or "online".
    """

    def __init__(self, workdir: Path, config: Config):
        self._workdir, self._config = workdir, config
        self._path = workdir / "wandb" / "dpc_jax.json"
        self._id, self._told = self._read()
        self._run: Any = None
        self._row: dict[str, Any] = {}
        self._step = self._told

    def _read(self) -> tuple[str, int]:
        """The id of the run, and the last step that was told."""
        try:
            kept = json.loads(self._path.read_text(encoding="utf-8"))
            return str(kept["id"]), int(kept["step"])
        except (OSError, ValueError, KeyError, TypeError):
            return secrets.token_hex(4), -1

    def begin(self, records: Sequence[dict]):
        """Start the run where there is something to train, and tell what is new.

        Raises:
          ValueError: where nobody is logged in, or the service is not reached.
        """
        steps_done = records[-1]["step"] if records else 0
        if steps_done > self._told or steps_done < self._config.train.steps:
            self._run = self._start()
        for record in records:
            self.write(record)

    def write(self, record: dict):
        """Take one record; it is told with all that its step has."""
        row = dict(list_scalars(record))
        row |= {
            name: wandb.Histogram(np_histogram=(np.array(shares), np.array(edges)))
            for name, (shares, edges) in list_histograms(record).items()
        }
        self._add(record["step"], row)

    def show(self, step: int, picture: np.ndarray):
        """Take the picture of a validation."""
        self._add(step, {PICTURE: wandb.Image(picture)})

    def close(self):
        """Tell the last row, and wait until all is written or sent."""
        self._tell()
        if self._run is not None:
            self._run.finish()

    def _add(self, step: int, row: dict):
        if step <= self._told:
            return
        if step > self._step:
            self._tell()
            self._step = step
        self._row |= row

    def _tell(self):
        """Log the row of the step that is complete."""
        if not self._row:
            return
        self._run.log(self._row, step=self._step, commit=True)
        self._row, self._told = {}, self._step
        write_json(self._path, {"id": self._id, "step": self._told})

    def _start(self):
        mode = "online" if self._config.log.wandb == "online" else "offline"
        try:
            return wandb.init(
                project=os.environ.get("WANDB_PROJECT", "dpc_jax"),
                name=self._workdir.name,
                group=re.sub(r"-seed\d+$", "", self._workdir.name),
                id=self._id,
                dir=str(self._workdir),
                mode=mode,
                resume="allow" if mode == "online" else None,
                config=asdict(self._config),
                # The terminal belongs to the progress of the run.
                settings=wandb.Settings(silent=True, console="off", force=True),
            )
        except wandb.Error as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise ValueError(
                f"Expected to start a run of Weights & Biases, but {reason}; give the "
                "command `wandb login` first, or --config.log.wandb=offline."
            ) from None
