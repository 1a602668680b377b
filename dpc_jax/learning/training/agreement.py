"""What the processes of a job tell each other and decide together."""

import hashlib
import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from orbax.checkpoint import multihost

from dpc_jax.config import Config, list_fields, name_differences

# For what process 0 does alone while the others wait for it, and for slow hosts.
PATIENCE_SECONDS = 4 * 3600
# What may differ between the processes of a job.
OWN_FIELDS = ("data.cache_dir",)
PACKAGES = ("dpc_jax", "jax", "jaxlib", "flax", "optax", "numpy")

_Result = TypeVar("_Result")


class Job:
    """The processes that work together; one on its own has nobody to wait for.

    All processes call the same methods in the same order.
    """

    def __init__(self, processes: int = 1, process: int = 0):
        """process: which of them this one is, from 0."""
        self.processes, self.process = processes, process
        self._waits = 0

    @property
    def is_first(self) -> bool:
        """Whether this is the process that writes log, checkpoints and report."""
        return self.process == 0

    def wait(self, name: str, *, seconds: float = PATIENCE_SECONDS):
        """Wait until all processes have come here; each name is used once."""
        if self.processes > 1:
            wait = multihost.get_barrier_sync_fn()
            wait(key=f"dpc_jax/{name}", timeout_ms=int(1000 * seconds))

    def gather(self, text: str) -> list[str]:
        """What each of the processes says, in their order."""
        if self.processes == 1:
            return [text]
        self._waits += 1
        self.wait(f"gather-{self._waits}")  # a collective has less patience
        own = np.frombuffer(text.encode(), np.uint8)
        sizes = multihost_utils.process_allgather(np.int32(own.size))
        padded = np.pad(own, (0, max(1, sizes.max()) - own.size))
        rows = multihost_utils.process_allgather(padded)
        return [
            row[:size].tobytes().decode() for row, size in zip(rows, sizes, strict=True)
        ]

    def check_same(self, config: Config):
        """Check that all processes have the same config and versions.

        Raises:
          ValueError: in every process, naming what differs.
        """
        if self.processes == 1:
            return
        here, all_devices = jax.local_device_count(), jax.device_count()
        if all_devices != self.processes * here:
            raise ValueError(
                "All processes of a job must have as many devices, but this one has "
                f"{here} and all {self.processes} together {all_devices}; start all of "
                "them with the same command."
            )
        told = self.gather(json.dumps(list_versions(config)))
        first, *others = map(json.loads, told)
        for process, other in enumerate(others, start=1):
            if differing := name_differences(first, other):
                raise ValueError(
                    "All processes of a job must have the same config and versions, "
                    f"but process {process} differs from process 0 in "
                    f"{', '.join(differing)}; start all of them with the same command "
                    "from the same installation."
                )

    def do_first(self, action: Callable[[], _Result]) -> _Result | None:
        """Have process 0 do something while the others wait, which get None.

        Raises:
          ValueError: in the others, with the sentence with which process 0 failed.
        """
        result, said = None, ""
        try:
            if self.is_first:
                result = action()
        except BaseException as error:
            said = str(error) or type(error).__name__
            raise
        finally:
            said = self.gather(said)[0]
        if said:
            raise ValueError(said)
        return result

    def agree_to_stop(self, is_asked: Callable[[], bool]) -> Callable[[], bool]:
        """A question for after each step, which all processes answer alike.

        Any of them may be asked to stop; all stop a step later.
        """
        if self.processes == 1:
            return is_asked
        devices = jax.sharding.Mesh(jax.devices(), ("devices",))
        each = jax.NamedSharding(devices, jax.P("devices"))
        is_any = jax.jit(jnp.any, out_shardings=jax.NamedSharding(devices, jax.P()))
        votes: list[jax.Array] = []

        def stops() -> bool:
            own = np.full(1, is_asked())
            shape = (jax.device_count(),)
            all_of_them = jax.make_array_from_callback(shape, each, lambda _: own)
            votes.append(is_any(all_of_them))
            # The newest would be there only after the step that is being computed.
            return len(votes) > 1 and bool(votes.pop(0))

        return stops


def list_versions(config: Config) -> dict[str, Any]:
    """What all processes must have alike: versions of libraries, code, and config."""
    told = {f"the version of {n}": importlib.metadata.version(n) for n in PACKAGES}
    # An editable installation has one version only.
    root, digest = Path(__file__).parents[2], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    told["the code of dpc_jax"] = digest.hexdigest()[:12]
    fields = list_fields(config).items()
    return told | {f"config.{n}": v for n, v in fields if n not in OWN_FIELDS}
