"""Preparing the shards of a data set, by any number of processes.

Nobody hands out work: every process goes through the shards that are missing, each from
another place, and makes those that it can claim. So processes that know nothing of each
other share a set in the same way as the workers of one command.

Workers are plain Python processes. They read on their input what to make, and report
with a line per model. They are not forked, because jax runs threads.
"""

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.data import shards
from dpc_jax.data.sources import Model, Source
from dpc_jax.files import Damage, claiming

BOOT = "from dpc_jax.data import workers; workers.work()"
INLINE = 16  # so few models are done before a worker has imported what it needs
SHARD_MODELS = (4, 64)  # fewest and most in a shard
SHARD_BYTES = 64 << 20  # a worker holds one shard in memory


def plan_shards(source: Source, models: Sequence[Model]) -> list[range]:
    """Which models go into which shard: ranges of indices, in order.

    The plan depends on the models alone, so that any number of processes, and a process
    that continues where another has stopped, write the same files.
    """
    few, many = SHARD_MODELS
    most = min(max(few, -(-len(models) // 16)), many)
    plan, start, size = [], 0, 0
    for index, model in enumerate(models):
        size += source.estimate_bytes(model)
        if index > start and (index - start == most or size > SHARD_BYTES):
            plan.append(range(start, index))
            start, size = index, source.estimate_bytes(model)
    return [*plan, range(start, len(models))]


def locate_shard(folder: str | Path, number: int) -> Path:
    """The file of a shard."""
    return Path(folder) / f"shard-{number:05d}.npz"


def _identify(folder, indices) -> dict[str, Any]:
    """What tells a shard from those of other sets and other models."""
    return {"set": Path(folder).name, "models": [indices.start, indices.stop]}


def is_whole(folder: Path, indices: range, number: int) -> bool:
    """Whether a shard is there, undamaged and of these models; if damaged, it goes."""
    path = locate_shard(folder, number)
    try:
        record, expected = shards.read_record(path), _identify(folder, indices)
        if {name: record.get(name) for name in expected} != expected:
            raise Damage("it belongs to another set or other models")
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        print(f"The shard {path} is damaged ({error}) and will be made again.")
        path.unlink(missing_ok=True)
        return False
    return True


def write_shards(
    folder: Path, source: Source, models: Sequence[Model], numbers: Sequence[int]
) -> Generator[int]:
    """Make those shards that nobody else has made or is at work on.

    Yields the index of each model that is done.
    """
    plan = plan_shards(source, models)
    for number in numbers:
        with claiming(path := locate_shard(folder, number)) as is_ours:
            if is_ours and not path.exists():
                yield from _write_shard(path, source, models, plan[number])


def _write_shard(path, source, models, indices):
    record = _identify(path.parent, indices)
    record |= {"names": [], "counts": {}, "skipped": [], "remarks": []}
    rows = {}
    for index in indices:
        name = models[index].name
        try:
            arrays, remarks = source.make_arrays(models[index], index)
        except ValueError as error:
            record["skipped"].append([name, str(error)])
        else:
            record["names"].append(name)
            record["remarks"] += [[name, remark] for remark in remarks]
            for key, array in arrays.items():
                rows.setdefault(key, []).append(array)
        if index < indices.stop - 1:
            yield index
    record["counts"] = {key: [len(a) for a in part] for key, part in rows.items()}
    joined = {key: np.concatenate(part) for key, part in rows.items()}
    shards.write_shard(path, joined, record)
    yield indices.stop - 1  # done when it is safely on disk


def write_together(
    folder: Path,
    source: Source,
    models: Sequence[Model],
    numbers: Sequence[int],
    *,
    processes: int,
) -> Generator[int]:
    """Make the shards that nobody else makes, then wait for those of the others.

    A shard that another process has begun and given up is taken over. Yields the index
    of each model when it is done, whoever made it.
    """
    plan, missing = plan_shards(source, models), list(numbers)
    while missing:
        done = set()
        count = sum(len(plan[number]) for number in missing)
        if processes == 1 or count <= INLINE:
            results = write_shards(folder, source, models, missing)
        else:
            workers = min(processes, len(missing))
            results = _write_in_processes(folder, source, models, missing, workers)
        with contextlib.closing(results):
            for index in results:
                done.add(index)
                yield index
        for number in missing:
            if locate_shard(folder, number).exists():
                yield from (index for index in plan[number] if index not in done)
        missing = [n for n in missing if not locate_shard(folder, n).exists()]
        while missing and not any(_is_free(folder, number) for number in missing):
            time.sleep(0.2)


def _is_free(folder, number):
    """Whether nobody is at work on a shard: it is there, or was given up."""
    with claiming(locate_shard(folder, number)) as is_free:
        return is_free


def rotate(numbers: Sequence[int], part: int, parts: int) -> list[int]:
    """The numbers from where one of several processes begins, so that they part."""
    first = len(numbers) * part // parts
    return [*numbers[first:], *numbers[:first]]


def work():
    """Body of a worker: make shards, with a line on stdout per model."""
    try:
        for index in write_shards(*pickle.load(sys.stdin.buffer)):
            sys.stdout.write(f"{index}\n")  # in one piece: others write there, too
            sys.stdout.flush()
    except OSError as error:
        print(error, file=sys.stderr)
        sys.exit(os.EX_IOERR)


def _write_in_processes(folder, source, models, numbers, count):
    """`write_shards` by worker processes; however it ends, no worker outlives it."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    reader, writer = os.pipe()
    workers, logs = [], []
    with contextlib.ExitStack() as stack:
        lines = stack.enter_context(open(reader, encoding="utf-8"))
        try:
            for _ in range(count):
                logs.append(stack.enter_context(tempfile.TemporaryFile()))
                worker = subprocess.Popen(
                    [sys.executable, "-c", BOOT],
                    stdin=subprocess.PIPE,
                    stdout=writer,
                    stderr=logs[-1],
                    env={**os.environ, **threads},
                    start_new_session=True,  # we handle Ctrl-C and stop them
                )
                stack.callback(_end, worker)
                workers.append(worker)
        finally:
            os.close(writer)  # so that the lines end with the last worker
        for part, worker in enumerate(workers):
            with contextlib.suppress(BrokenPipeError):  # then its status tells why
                mine = rotate(numbers, part, count)
                pickle.dump((folder, source, models, mine), worker.stdin)
                worker.stdin.close()
        yield from map(int, lines)
        for worker, log in zip(workers, logs, strict=True):
            if status := worker.wait():
                log.seek(0)
                tail = log.read().decode("utf-8", errors="replace")[-2000:].strip()
                if status == os.EX_IOERR:
                    raise OSError(tail.rsplit("\n", 1)[-1])
                raise RuntimeError(
                    "Expected a render process to end well, but it ended with status "
                    f"{status}; set data.processes to 1 to look closer. Its last "
                    f"words:\n{tail}."
                )


def _end(worker):
    worker.terminate()  # does nothing to one that has ended
    worker.wait()
    with contextlib.suppress(BrokenPipeError):
        worker.stdin.close()


def follow(
    results: Iterable[Any], *, count: int, label: str, progress: bool
) -> Iterator[Any]:
    """Pass on `count` results, one per model, and show how far they are."""
    if not progress:
        yield from results
        return
    if sys.stdout.isatty():
        from rich.progress import track  # not loaded where no bar is drawn

        yield from track(results, description=label, total=count)
        return
    start, shown = time.monotonic(), 0
    for done, result in enumerate(results, start=1):
        yield result
        if 10 * done // count > shown:
            shown = 10 * done // count
            rate = done / max(time.monotonic() - start, 1e-9)
            print(
                f"{label}: {done}/{count} models, {rate:.1f}/s, "
                f"{(count - done) / rate:.0f} s left",
                flush=True,
            )
