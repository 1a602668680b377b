"""Preparing the shards of a data set, by any number of processes.

Nobody hands out work: every process goes through the shards that are missing and makes
those that it can claim. So processes that know nothing of each other share a set in the
same way as the workers of one command.

Workers are plain Python processes, which read on their input what to make: forks would
meet the threads of jax, and `multiprocessing` would import the caller's script again.
"""

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.data import shards
from dpc_jax.data.sources import Model, Source
from dpc_jax.files import Damage, claiming

BOOT = "from dpc_jax.data import workers; workers.work()"
INLINE = 16  # so few models are done before a worker has imported what it needs
SHARD_MODELS = (4, 64)  # fewest and most in a shard
SHARD_BYTES = 64 << 20  # a worker holds one shard in memory


class Plan(NamedTuple):
    """The shards of a set: the folder they lie in, and which models go into each."""

    folder: Path
    source: Source
    models: Sequence[Model]
    ranges: list[range]  # of indices of the models, by the number of the shard

    def locate(self, number: int) -> Path:
        """The file of a shard."""
        return self.folder / f"shard-{number:05d}.npz"

    def count(self, numbers: Iterable[int]) -> int:
        """How many models some of the shards have."""
        return sum(len(self.ranges[number]) for number in numbers)

    def _identify(self, number) -> dict[str, Any]:
        """What tells a shard from those of other sets and other models."""
        indices = self.ranges[number]
        return {"set": self.folder.name, "models": [indices.start, indices.stop]}

    def is_whole(self, number: int) -> bool:
        """Whether a shard is there as it was written; one that is damaged goes."""
        path, expected = self.locate(number), self._identify(number)
        try:
            record = shards.map_shard(path).record
            if {name: record.get(name) for name in expected} != expected:
                raise Damage("it belongs to another set or other models")
        except FileNotFoundError:
            return False
        except (OSError, ValueError) as error:
            print(f"The shard {path} is damaged ({error}) and will be made again.")
            path.unlink(missing_ok=True)
            return False
        return True

    def write(self, number: int):
        """Make the arrays of a shard's models and write them."""
        record = self._identify(number)
        record |= {"names": [], "counts": {}, "skipped": [], "remarks": []}
        rows = {}
        for index in self.ranges[number]:
            name = self.models[index].name
            try:
                arrays, remarks = self.source.make_arrays(self.models[index], index)
            except ValueError as error:
                record["skipped"].append([name, str(error)])
                continue
            record["names"].append(name)
            record["remarks"] += [[name, remark] for remark in remarks]
            for key, array in arrays.items():
                rows.setdefault(key, []).append(array)
        record["counts"] = {key: [len(a) for a in part] for key, part in rows.items()}
        joined = {key: np.concatenate(part) for key, part in rows.items()}
        shards.write_shard(self.locate(number), joined, record)


def plan_shards(folder: Path, source: Source, models: Sequence[Model]) -> Plan:
    """Which models go into which shard, in order.

    The plan depends on the models alone, so that any number of processes, and a process
    that continues where another has stopped, write the same files.
    """
    few, many = SHARD_MODELS
    most = min(max(few, -(-len(models) // 16)), many)
    ranges, start, size = [], 0, 0
    for index, model in enumerate(models):
        own = 8 * source.spec.image_size**2 * model.views  # bytes, without its points
        size += own
        if index > start and (index - start == most or size > SHARD_BYTES):
            ranges.append(range(start, index))
            start, size = index, own
    return Plan(folder, source, models, [*ranges, range(start, len(models))])


def write_shards(plan: Plan, numbers: Sequence[int]) -> Generator[None]:
    """Make those shards that nobody else has made or is at work on, and yield."""
    for number in numbers:
        with claiming(path := plan.locate(number)) as is_ours:
            if is_ours and not path.exists():
                plan.write(number)
        yield


def write_together(
    plan: Plan, missing: Sequence[int], *, processes: int
) -> Generator[int]:
    """Make the shards that nobody else makes, then wait for those of the others.

    A shard that another process has begun and given up is taken over. Yields how many
    models are still missing on disk, whoever makes them.
    """
    missing = list(missing)
    processes = min(processes, len(missing)) if plan.count(missing) > INLINE else 1
    while missing:
        if processes > 1:
            work = _write_in_processes(plan, missing, processes)
        else:
            work = write_shards(plan, missing)
        with contextlib.closing(work):
            for _ in work:
                missing = [n for n in missing if not plan.locate(n).exists()]
                yield plan.count(missing)
        processes = 1  # few are left: others are at work on them, or have given up
        if missing:
            time.sleep(0.2)


def work():
    """Body of a worker: make the shards that its input names until its parent dies."""
    parent = os.getppid()
    for _ in write_shards(*pickle.load(sys.stdin.buffer)):
        if os.getppid() != parent:
            break


def _write_in_processes(plan, numbers, count):
    """As `write_shards`, by workers; however it ends, none of them outlives it."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    workers = []
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            task, log = (
                stack.enter_context(tempfile.TemporaryFile()) for _ in range(2)
            )
            pickle.dump((plan, numbers), task)
            task.seek(0)
            worker = subprocess.Popen(
                [sys.executable, "-c", BOOT],
                stdin=task,
                stdout=log,
                stderr=log,
                env=os.environ | threads,
                start_new_session=True,  # we handle Ctrl-C and stop them
            )
            stack.callback(worker.wait)
            stack.callback(worker.terminate)  # does nothing to one that has ended
            workers.append((worker, log))
        while any(worker.poll() is None for worker, _ in workers):
            time.sleep(0.1)
            yield
        for worker, log in workers:
            if worker.returncode:
                log.seek(0)
                tail = log.read().decode("utf-8", errors="replace")[-2000:].strip()
                raise ChildProcessError(
                    "Expected a render process to end well, but it ended with status "
                    f"{worker.returncode}; run the command on one core (taskset -c 0) "
                    f"to look closer. Its last words:\n{tail}."
                )
    yield
