"""What the processes of a job agree on, by jax's coordination service."""

import dataclasses
import hashlib
import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from flax.traverse_util import flatten_dict
from jax._src import distributed
from jax.experimental import multihost_utils

from dpc_jax.config import Config

# For what process 0 does alone while the others wait for it, and for slow hosts.
PATIENCE_SECONDS = 4 * 3600
# What may differ between the processes of a job.
FREE_FIELDS = ("data.cache_dir", "data.processes")
PACKAGES = ("dpc_jax", "jax", "jaxlib", "flax", "optax", "numpy")

_Result = TypeVar("_Result")


class Job:
    """The processes that work together; one on its own has nobody to wait for.

    Attributes:
      processes: how many there are.
      process: which of them this one is, from 0.
    """

    def __init__(self, processes: int = 1, process: int = 0):
        self.processes, self.process = processes, process
        self._questions = 0

    @property
    def is_first(self) -> bool:
        """Whether this is the process that writes log, checkpoints and report."""
        return self.process == 0

    def wait(self, name: str, *, seconds: float = PATIENCE_SECONDS):
        """Wait until all processes have come here; each name is used once."""
        if self.processes > 1:
            _client().wait_at_barrier(f"dpc_jax/{name}", int(1000 * seconds))

    def gather(self, name: str, text: str) -> list[str]:
        """What the processes say under a name, in their order; all must take part."""
        if self.processes == 1:
            return [text]
        client, wait = _client(), 1000 * PATIENCE_SECONDS
        client.key_value_set(f"dpc_jax/{name}/{self.process}", text)
        return [
            client.blocking_key_value_get(f"dpc_jax/{name}/{process}", wait)
            for process in range(self.processes)
        ]

    def check_same(self, config: Config):
        """Check that all processes have the same config and versions.

        Raises:
          ValueError: in every process, naming what differs.
        """
        if self.processes == 1:
            return
        told = self.gather("versions", json.dumps(_list_versions(config)))
        differing = _name_differences([json.loads(text) for text in told])
        self.wait("versions-read")  # none ends before all have seen it
        if differing:
            raise ValueError(
                "All processes of a job must have the same config and versions, but "
                f"{differing}; start all of them with the same command from the same "
                "installation."
            )

    def do_first(self, name: str, action: Callable[[], _Result]) -> _Result | None:
        """Have process 0 do something while the others wait, which get None.

        Raises:
          ValueError: in the others, with the sentence with which process 0 failed.
        """
        if self.processes == 1:
            return action()
        said = ""
        try:
            if self.is_first:
                return action()
        except BaseException as error:
            said = str(error) or type(error).__name__
            raise
        finally:
            if self.is_first:
                _client().key_value_set(f"dpc_jax/{name}", said)
                self.wait(f"{name}-done")
        said = _client().blocking_key_value_get(
            f"dpc_jax/{name}", 1000 * PATIENCE_SECONDS
        )
        self.wait(f"{name}-done")
        if said:
            raise ValueError(said)
        return None

    def share(self, tree: Any) -> Any:
        """The arrays that process 0 has, bit for bit, as numpy arrays in every process.

        Args:
          tree: arrays; those of the other processes give only shapes and dtypes.
        """
        if self.processes == 1:
            return tree
        leaves, structure = jax.tree.flatten(tree)
        # As whole numbers: the sum with zeros that jax sends keeps no sign of a zero.
        shared = multihost_utils.broadcast_one_to_all(
            [np.frombuffer(np.asarray(leaf).tobytes(), np.uint8) for leaf in leaves]
        )
        return jax.tree.unflatten(
            structure,
            [
                np.asarray(part, np.uint8).view(leaf.dtype).reshape(leaf.shape)
                for part, leaf in zip(shared, leaves, strict=True)
            ],
        )

    def agree_to_stop(self, is_asked: Callable[[], bool]) -> Callable[[], bool]:
        """A question for after each step, which all processes answer alike.

        Any of them may be asked to stop. Process 0 hears of it and names a step that
        none has reached.
        """
        if self.processes == 1:
            return is_asked
        self._questions += 1
        return StopVote(self, f"dpc_jax/stop-{self._questions}", is_asked)


class StopVote:
    """Whether to stop after this step, asked after every step by every process.

    Args:
      job: of the processes.
      name: of this vote.
      is_asked: whether this process was asked to stop.
    """

    # A step needs all processes, and each has read the results of the step before the
    # last when it is asked: none can be more than two steps ahead of process 0.
    AHEAD = 3

    def __init__(self, job: Job, name: str, is_asked: Callable[[], bool]):
        self._job, self._name, self._is_asked = job, name, is_asked
        self._steps, self._last, self._has_asked = 0, None, False

    def __call__(self) -> bool:
        """Count a step, and say whether all processes stop after it."""
        self._steps += 1
        if self._last is None:
            self._last = self._decide() if self._job.is_first else self._ask()
        return self._last is not None and self._steps >= self._last

    def _decide(self):
        if not (self._is_asked() or _read(f"{self._name}/asked")):
            return None
        last = self._steps + self.AHEAD
        _client().key_value_set(f"{self._name}/last", str(last))
        return last

    def _ask(self):
        if self._is_asked() and not self._has_asked:
            _client().key_value_set(f"{self._name}/asked", "yes", allow_overwrite=True)
            self._has_asked = True
        last = _read(f"{self._name}/last")
        return int(last) if last else None


def _client():
    # What multihost_utils and orbax use too: jax has no public name for it.
    client = distributed.global_state.client
    assert client is not None
    return client


def _read(key):
    """A value that may not be there yet."""
    try:
        return _client().key_value_try_get(key)
    except jax.errors.JaxRuntimeError as error:
        if "NOT_FOUND" in str(error):
            return None
        raise


def _list_versions(config) -> dict:
    versions = {f"the version of {n}": importlib.metadata.version(n) for n in PACKAGES}
    versions["the code of dpc_jax"] = _digest_code()[:12]
    fields = flatten_dict(dataclasses.asdict(config), sep=".")
    return versions | {
        f"config.{name}": value
        for name, value in fields.items()
        if name not in FREE_FIELDS
    }


def _digest_code() -> str:
    """SHA-256 of the package's files: an editable installation has one version only."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


def _name_differences(told: list[dict]) -> str:
    """What the processes differ in, and "" where they do not."""
    first, parts = told[0], []
    for process, other in enumerate(told[1:], start=1):
        differing = [
            f"{name} ({first.get(name)!r} there, {other.get(name)!r} here)"
            for name in sorted(first.keys() | other.keys())
            if first.get(name) != other.get(name)
        ]
        if differing:
            named = ", ".join(differing[:5])
            parts.append(f"process {process} differs from process 0 in {named}")
    return "; ".join(parts[:3]).replace("; ", " and ")
