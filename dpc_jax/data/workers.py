"""Preparing the shards of a data set, in one process or several.

Workers are plain Python processes that write whole shards. They read on their input
which ones, and report on a pipe, one JSON line per model. They are not forked, because
jax runs threads.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.data import shards
from dpc_jax.data.shard_plan import (
    find_damage,
    identify_shard,
    name_shard,
    plan_shards,
)
from dpc_jax.data.sources import Model, Source, open_source
from dpc_jax.data.spec import DataSpec
from dpc_jax.files import claiming

BOOT = """
import sys
from dpc_jax.data import workers
workers.work(sys.argv[1], part=int(sys.argv[2]))
"""
INLINE = 16  # so few models are done before a worker has imported what it needs


def write_shards(
    folder: str | Path, source: Source, models: Sequence[Model], numbers: Iterable[int]
) -> Generator[tuple[int, str | None]]:
    """Prepare and write shards; yield (index, None or reason to skip) per model.

    A shard that another process has finished meanwhile is passed on as done. Of one
    that another process is at work on nothing is yielded.
    """
    plan = plan_shards(source, models)
    for number in numbers:
        with claiming(Path(folder) / name_shard(number)) as is_ours:
            if not is_ours:
                continue
            if find_damage(folder, plan[number], number) == "":
                yield from ((index, None) for index in plan[number])
            else:
                yield from _write_shard(folder, source, models, plan[number], number)


def _write_shard(folder, source, models, indices, number):
    record = identify_shard(folder, indices)
    record |= {"names": [], "counts": {}, "skipped": [], "remarks": []}
    rows, reason = {}, None
    for index in indices:
        name, reason = models[index].name, None
        try:
            arrays, remarks = source.make_arrays(models[index], index)
        except ValueError as error:
            reason = str(error)
            record["skipped"].append([name, reason])
        else:
            record["names"].append(name)
            record["remarks"] += [[name, remark] for remark in remarks]
            for key, array in arrays.items():
                rows.setdefault(key, []).append(array)
        if index < indices.stop - 1:
            yield index, reason
    record["counts"] = {key: [len(a) for a in part] for key, part in rows.items()}
    joined = {key: np.concatenate(part) for key, part in rows.items()}
    shards.write_shard(Path(folder) / name_shard(number), joined, record)
    # the last model counts as done when it is safely on disk
    yield indices.stop - 1, reason


def write_together(
    folder: str | Path,
    source: Source,
    models: Sequence[Model],
    numbers: Sequence[int],
    *,
    processes: int,
) -> Generator[tuple[int, str | None]]:
    """Write the shards that nobody else writes, then wait for those of the others.

    A shard that another process has begun and given up is taken over. Yields as
    `write_shards`, of every model.
    """
    missing = list(numbers)
    plan = plan_shards(source, models)
    place = {index: number for number in missing for index in plan[number]}
    while missing:
        count = sum(len(plan[number]) for number in missing)
        if processes == 1 or count <= INLINE:
            results = write_shards(folder, source, models, missing)
        else:
            results = write_shards_in_processes(
                folder, source, models, missing, processes=processes
            )
        done = set()
        with contextlib.closing(results):
            for index, reason in results:
                done.add(place[index])
                yield index, reason
        missing = [number for number in missing if number not in done]
        if missing:
            _await_any([Path(folder) / name_shard(number) for number in missing])


def _await_any(paths):
    """Return when one of the files that others make is there, or was given up."""
    while True:
        for path in paths:
            with claiming(path) as is_free:
                if is_free:
                    return
        time.sleep(0.2)


def work(folder: str, *, part: int):
    """Body of a worker: write the shards asked for, with a line on stdout per model."""
    plan = json.loads(sys.stdin.readline())
    spec = {k: tuple(v) if isinstance(v, list) else v for k, v in plan["spec"].items()}
    source = open_source(DataSpec(**dict[str, Any](spec)))
    models = [Model(*model) for model in plan["models"]]

    def tell(*message):
        sys.stdout.write(json.dumps([part, *message]) + "\n")
        sys.stdout.flush()

    try:
        tell("ready")
        for line in sys.stdin:
            for index, reason in write_shards(folder, source, models, [int(line)]):
                tell("model", index, reason and reason[:1000])
            tell("ready")
    except OSError as error:
        tell("failed", str(error)[:1000])


def write_shards_in_processes(
    folder: str | Path,
    source: Source,
    models: Sequence[Model],
    numbers: Sequence[int],
    *,
    processes: int,
) -> Generator[tuple[int, str | None]]:
    """`write_shards` by worker processes, in the order in which models finish."""
    plan = {"spec": vars(source.spec), "models": [list(model) for model in models]}
    waiting = list(reversed(numbers))
    with _start_workers(folder, min(processes, len(numbers))) as (workers, logs, lines):
        for worker in workers:
            _send(worker, json.dumps(plan))
        for line in lines:
            part, kind, *message = json.loads(line)
            if kind == "model":
                yield message[0], message[1]
            elif kind == "failed":
                raise OSError(message[0])
            elif waiting:
                _send(workers[part], waiting.pop())
            else:
                _close(workers[part])
        for worker, log in zip(workers, logs, strict=True):
            if worker.wait() != 0:
                log.seek(0)
                tail = log.read().decode("utf-8", errors="replace")[-2000:].strip()
                raise RuntimeError(
                    "Expected a render process to end well, but it ended with status "
                    f"{worker.returncode}; set data.processes to 1 to look closer. Its "
                    f"last words:\n{tail}."
                )


@contextlib.contextmanager
def _start_workers(folder, count):
    """Worker processes, their error outputs, and the lines that they all write.

    However the block is left, no worker outlives it.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    reader, writer = os.pipe()
    workers, logs = [], []
    with contextlib.ExitStack() as stack:
        lines = stack.enter_context(open(reader, encoding="utf-8"))
        try:
            for part in range(count):
                logs.append(stack.enter_context(tempfile.TemporaryFile()))
                worker = subprocess.Popen(
                    [sys.executable, "-c", BOOT, str(folder), str(part)],
                    stdin=subprocess.PIPE,
                    stdout=writer,
                    stderr=logs[-1],
                    env={**os.environ, **threads},
                    start_new_session=True,  # we handle Ctrl-C and stop them
                    text=True,
                )
                stack.callback(_end, worker)
                workers.append(worker)
        finally:
            os.close(writer)  # so that the lines end with the last worker
        yield workers, logs, lines


def _end(worker):
    worker.terminate()  # does nothing to one that has ended
    worker.wait()
    _close(worker)


def _send(worker, message):
    # a worker that has died tells it by its status
    with contextlib.suppress(BrokenPipeError):
        worker.stdin.write(f"{message}\n")
        worker.stdin.flush()


def _close(worker):
    with contextlib.suppress(BrokenPipeError):
        worker.stdin.close()
