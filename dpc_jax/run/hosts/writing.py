"""What process 0 of a job writes for all: the checkpoints and the log.

Each class has the face of the one that a process on its own uses, and every process
calls it at the same steps. Only process 0 needs the workdir.
"""

import contextlib
import functools
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import SingleDeviceSharding

from dpc_jax.learning.step import TrainState
from dpc_jax.learning.training.checkpoints import Checkpoints, Restored
from dpc_jax.run.hosts.agreement import Job


def open_checkpoints(folder: Path, job: Job) -> Checkpoints:
    """The checkpoints in a folder, of one process or of several."""
    return SharedCheckpoints(folder, job) if job.processes > 1 else Checkpoints(folder)


def restore_last(folder: Path, like: TrainState) -> TrainState:
    """The last state of a run that is not gone on with; nothing is made in its folder.

    Raises:
      ValueError: where there is no checkpoint, or none that can be read.
    """
    found = None
    if folder.is_dir():
        with contextlib.closing(Checkpoints(folder)) as checkpoints:
            try:
                found = checkpoints.restore(describe_here(like))
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
    return jax.tree.map(spread_array, found.state, like)


class SharedCheckpoints(Checkpoints):
    """Checkpoints of a job; the state may be spread over the devices of all processes.

    Process 0 writes the whole arrays. So any number of processes can go on from them.
    """

    def __init__(self, folder: Path, job: Job):
        self._job = job
        if job.is_first:
            super().__init__(folder)

    def close(self):
        """Wait for what is being written."""
        if self._job.is_first:
            super().close()

    def save(self, state: TrainState, *, seconds: float):
        """Write the state under its step; does nothing where that step is saved.

        Raises:
          ValueError: in the other processes, where process 0 cannot write.
        """
        whole = jax.tree.map(gather_array, state)
        save = functools.partial(super().save, whole, seconds=seconds)
        self._job.do_first(save)

    def set_aside(self, steps: Iterable[int]):
        """Move checkpoints to damaged-checkpoint-STEP beside the folder."""
        if self._job.is_first:
            super().set_aside(steps)

    def restore(self, like: TrainState) -> Restored | None:
        """The newest checkpoint that process 0 can read, on the devices of all.

        Raises:
          ValueError: if there are checkpoints, yet none can be read.
        """
        there, restore = describe_here(like), super().restore
        found = self._job.do_first(lambda: restore(there))
        facts = [found.seconds, found.damaged] if found else None
        told = json.loads(self._job.gather(json.dumps(facts))[0])
        if told is None:
            return None
        seconds, damaged = told
        read = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), there)
        read = multihost_utils.broadcast_one_to_all(
            jax.device_get(found.state) if found else read
        )
        state = jax.tree.map(spread_array, read, like)
        return Restored(state, seconds, tuple(damaged))


def describe_here(like: TrainState) -> TrainState:
    """What `describe_state` says of a state, on the first device of this process."""
    own = SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(
        lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype, sharding=own), like
    )


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
