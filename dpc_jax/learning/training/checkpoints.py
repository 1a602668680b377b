"""Checkpoints of a run: everything to go on from, whole or not at all (orbax)."""

import contextlib
import errno
import json
import os
import shutil
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from absl import logging
from jax.experimental import multihost_utils
from orbax import checkpoint as ocp

from dpc_jax.files import explaining_full_disk
from dpc_jax.learning.recipe import Averages
from dpc_jax.learning.step import TrainState
from dpc_jax.learning.training.agreement import Job

KEPT = 2  # the newest and, should that be damaged, the one before


class Restored(NamedTuple):
    """A checkpoint read back.

    Attributes:
      state: the training state.
      seconds: training time spent until then.
      damaged: steps of newer checkpoints that could not be read.
    """

    state: TrainState
    seconds: float
    damaged: tuple[int, ...]


class Checkpoints:
    """The checkpoints in one folder; writes to a temporary name, then renames.

    All processes of a job call it at the same steps, and the state may be spread over
    the devices of all. Process 0 writes the whole arrays, and alone needs the folder:
    any number of processes can go on from them.
    """

    def __init__(self, folder: str | os.PathLike, job: Job = Job()):
        self._folder, self._job = Path(folder).absolute(), job
        if not job.is_first:
            return
        # Orbax reports every file that it touches, and of an error the tracebacks of
        # all its threads; it raises the error, too.
        logging.set_verbosity(logging.FATAL)
        self._has_failed = False
        self._folder.mkdir(parents=True, exist_ok=True)
        processes = ocp.options.MultiprocessingOptions()
        if jax.process_count() > 1:  # one writes and reads without waiting for others
            own = jax.process_index()
            processes = ocp.options.MultiprocessingOptions(
                primary_host=own,
                active_processes={own},
                barrier_sync_key_prefix=f"own-{own}",
            )
        options = ocp.CheckpointManagerOptions(
            max_to_keep=KEPT,
            create=False,
            enable_async_checkpointing=False,
            multiprocessing_options=processes,
        )
        self._manager = ocp.CheckpointManager(self._folder, options=options)

    def close(self):
        """Wait for what is being written.

        Raises:
          OSError: where the disk is full, unless `save` has said so.
        """
        if not self._job.is_first:
            return
        with contextlib.ExitStack() as stack:
            if self._has_failed:  # orbax raises the same error once more
                stack.enter_context(contextlib.suppress(Exception))
            stack.enter_context(explaining_full_disk(self._folder))
            self._manager.close()

    def save(self, state: TrainState, *, seconds: float):
        """Write the state under its step; does nothing where that step is saved.

        Raises:
          OSError: where the disk is full; the checkpoints that are there stay whole.
          ValueError: in the other processes, where process 0 cannot write.
        """
        if self._job.processes > 1:
            state = jax.tree.map(gather_array, state)
        self._job.do_first(lambda: self._write(state, seconds))

    def _write(self, state, seconds):
        step = int(state.step)
        if step in self.steps():
            return
        progress = {"seconds": seconds, "checksum": _checksum(state)}
        saved = ocp.args.Composite(
            state=ocp.args.StandardSave(_list_parts(state)),
            progress=ocp.args.JsonSave(progress),
        )
        try:
            with explaining_full_disk(self._folder):
                _require_room(self._folder, state)
                self._manager.save(step, args=saved, force=True)
        except Exception:
            self._has_failed = True
            for part in self._folder.glob(f"{step}.*"):  # of what is not whole
                shutil.rmtree(part, ignore_errors=True)
            raise

    def steps(self) -> list[int]:
        """Steps with a whole checkpoint, oldest first."""
        return sorted(self._manager.all_steps())

    def set_aside(self, steps: Iterable[int]):
        """Move checkpoints to damaged-checkpoint-STEP beside the folder.

        A run that went on from an earlier one can then save at those steps again.
        """
        if not self._job.is_first:
            return
        for step in steps:
            target = self._folder.with_name(f"damaged-checkpoint-{step}")
            shutil.rmtree(target, ignore_errors=True)
            os.replace(self._folder / str(step), target)
        self._manager.reload()

    def restore(self, like: TrainState) -> Restored | None:
        """The newest checkpoint that can be read, or None where there is none.

        Args:
          like: a state, or what `describe_state` says of it; the state comes back on
            the same devices.

        Raises:
          ValueError: if there are checkpoints, yet none can be read.
        """
        blank = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), like)
        found = self._job.do_first(lambda: self._read(blank))
        facts = [found.seconds, found.damaged] if found else None
        told = json.loads(self._job.gather(json.dumps(facts))[0])
        if told is None:
            return None
        seconds, damaged = told
        state = found.state if found else blank
        if self._job.processes > 1:
            state = multihost_utils.broadcast_one_to_all(state)
        state = jax.tree.map(spread_array, state, like)
        return Restored(state, seconds, tuple(damaged))

    def _read(self, like: TrainState) -> Restored | None:
        """What `restore` finds, in the memory of the host."""
        target = ocp.args.Composite(
            state=ocp.args.StandardRestore(_list_parts(like)),
            progress=ocp.args.JsonRestore(),
        )
        damaged = []
        for step in reversed(self.steps()):
            # Whatever a damaged file makes orbax raise, the one before is tried.
            with contextlib.suppress(Exception):
                loaded = self._manager.restore(step, args=target)
                parts = loaded["state"]
                parts["averages"] = Averages(**parts["averages"])
                state = TrainState(**parts)
                # Orbax notices a missing or short file, but not a changed byte.
                if loaded["progress"]["checksum"] == _checksum(state):
                    seconds = float(loaded["progress"]["seconds"])
                    return Restored(state, seconds, tuple(damaged))
            damaged.append(step)
        if damaged:
            raise ValueError(
                f"Expected a whole checkpoint in {self._folder}, but none of them "
                f"(steps {', '.join(map(str, damaged))}) could be read; choose another "
                "workdir or remove that folder to start anew."
            )
        return None


def restore_last(folder: Path, like: TrainState) -> TrainState:
    """The last state of a run that is not gone on with; nothing is made in its folder.

    Raises:
      ValueError: where there is no checkpoint, or none that can be read.
    """
    found = None
    if folder.is_dir():
        with contextlib.closing(Checkpoints(folder)) as checkpoints:
            try:
                found = checkpoints.restore(like)
            except ValueError:  # whose advice is for a run's own folder
                raise ValueError(
                    f"Expected a whole checkpoint in {folder}, but none of them could "
                    "be read; give the workdir of another run."
                ) from None
    if found is None:
        raise ValueError(
            f"Expected a checkpoint in {folder}, but there is none; give the workdir "
            "of a run that has saved one."
        )
    return found.state


def _list_parts(state: TrainState) -> dict:
    """The parts of a state by name; an average that the run has not is not saved."""
    averages = state.averages._asdict().items()
    return state._asdict() | {"averages": {n: a for n, a in averages if a is not None}}


def _require_room(folder: Path, state: TrainState):
    """Raise an OSError where a state does not fit on the disk.

    Orbax would find out while it writes, and its threads that then still write print
    tracebacks that nobody can catch.
    """
    needed = sum(leaf.nbytes for leaf in jax.tree.leaves(state))
    if shutil.disk_usage(folder).free < needed:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


def _checksum(state: TrainState) -> int:
    """CRC-32 of all leaves in their order."""
    value = 0
    for leaf in jax.tree.leaves(jax.device_get(state)):
        value = zlib.crc32(np.ascontiguousarray(leaf).tobytes(), value)
    return value


def gather_array(array: Any) -> np.ndarray:
    """A whole array in the memory of every process; all processes must call it."""
    if not isinstance(array, jax.Array) or array.is_fully_addressable:
        return np.asarray(array)
    if array.is_fully_replicated:
        return np.asarray(array.addressable_data(0))
    return np.asarray(multihost_utils.process_allgather(array, tiled=True))


def spread_array(array: Any, like: jax.Array) -> jax.Array:
    """An array that every process has, on the devices as another one is."""
    host = np.asarray(array)
    return jax.make_array_from_callback(host.shape, like.sharding, lambda i: host[i])
