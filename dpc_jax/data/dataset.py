"""A data set on disk: prepared once, kept under a key of everything that made it.

A cache folder holds shards and, when all are there, `spec.json`, which lists them with
size and checksum. Without it, preparing continues with the shards that are missing.
"""

import concurrent.futures
import contextlib
import errno
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from dpc_jax import files
from dpc_jax.config import ELEVATIONS
from dpc_jax.data import shards, workers
from dpc_jax.data.arrays import ROWS as ROWS
from dpc_jax.data.arrays import DataSet as DataSet
from dpc_jax.data.arrays import Pages, Stack
from dpc_jax.data.sources import Model, Source, open_source
from dpc_jax.data.spec import SUPERSAMPLE
from dpc_jax.data.spec import DataSpec as DataSpec
from dpc_jax.data.workers import follow
from dpc_jax.outputs import show_text

SHOWN = 20  # skipped models that are printed
VERSION = 3  # raise it when rendering, the procedural shapes or the shards change
PLACES = ("folder", "split_file", "ground_truth")  # fields that do not affect the bytes
RECORD = "spec.json"  # the file that finishes a cache


def load_or_render(
    spec: DataSpec,
    *,
    cache_dir: str | Path,
    processes: int | None = None,
    progress: bool = True,
    share: tuple[int, int] = (0, 1),
) -> DataSet:
    """The data set of a specification, from the cache or prepared now.

    Any number of processes may prepare one set in a shared folder.

    Args:
      cache_dir: folder of the caches; created where missing.
      processes: how many render at once; None for one per core. The result does not
        depend on it.
      progress: whether to show progress and what was skipped on stdout.
      share: (i, n), where the i-th of n processes (from 0) begins among the shards, so
        that they seldom meet.

    Raises:
      ValueError: if there is no folder, no model, or none that can be used.
      OSError: if the disk is full or the cache cannot be written.
    """
    source = open_source(spec, cache_dir)
    models = source.list_models()
    record = _describe(source, models)
    folder = locate_cache(source, models, cache_dir)
    # not of the cache: what a split is called must not depend on when it was read
    warnings = tuple(source.list_warnings())
    if (folder / RECORD).exists():
        try:
            return read_cache(folder)._replace(warnings=warnings)
        except (OSError, ValueError, KeyError, TypeError) as error:
            print(f"The cache {folder} is damaged ({error}) and will be repaired.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files.remove_leftovers(folder)
        _prepare(folder, source, models, share, processes, progress=progress)
        _finish(folder, source, models, record, progress=progress)
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        raise OSError(
            f"Expected to write the data set to {folder}, but it cannot be written "
            f"({error.strerror}); set another data.cache_dir."
        ) from None
    finally:
        files.remove_leftovers(folder)
        with contextlib.suppress(OSError):  # it is not empty
            folder.rmdir()
    return read_cache(folder)._replace(warnings=warnings)


def is_prepared(spec: DataSpec, cache_dir: str | Path) -> bool:
    """Whether `load_or_render` would find the set instead of preparing it."""
    source = open_source(spec, cache_dir)
    folder = locate_cache(source, source.list_models(), cache_dir)
    return (folder / RECORD).exists()


def locate_cache(
    source: Source, models: Sequence[Model], cache_dir: str | Path
) -> Path:
    """The cache folder of a data set, whether it exists or not."""
    spec = source.spec
    key = files.digest_text(json.dumps(_describe(source, models), sort_keys=True))
    return Path(cache_dir) / f"{spec.category}-{spec.split}-{key[:12]}"


def _describe(source, models):
    """Everything that determines the bytes, as JSON; the folder's place does not."""
    fields = vars(source.spec).items()
    record = {name: value for name, value in fields if name not in PLACES}
    record |= {"elevation": ELEVATIONS, "supersample": SUPERSAMPLE}
    record |= {"extent": 1.0, "version": VERSION}  # of the image plane
    record["sources"] = [[m.name, m.seed, m.copy, m.digest] for m in models]
    record["sidecars"] = source.list_sidecars()
    return record


def _prepare(folder, source, models, share, processes, *, progress):
    plan = workers.plan_shards(source, models)
    missing = [
        number
        for number, indices in enumerate(plan)
        if not workers.is_whole(folder, indices, number)
    ]
    if not missing:
        return
    count = sum(len(plan[number]) for number in missing)
    if 0 < len(missing) < len(plan) and progress:
        print(f"Continuing in {folder}: {count} of {len(models)} models are missing.")
    needed = sum(source.estimate_bytes(models[i]) for n in missing for i in plan[n])
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise OSError(
            f"Expected {needed / 1e9:.1f} GB free for {folder}, but there are "
            f"{free / 1e9:.1f}; free some or set another data.cache_dir."
        )
    results = workers.write_together(
        folder,
        source,
        models,
        workers.rotate(missing, *share),
        processes=processes or _count_cores(),
    )
    label = f"{source.work} {source.spec.split} {source.spec.category}"
    with contextlib.closing(results):
        for _ in follow(results, count=count, label=label, progress=progress):
            pass


def _finish(folder, source, models, record, *, progress):
    plan = workers.plan_shards(source, models)
    paths = [workers.locate_shard(folder, number) for number in range(len(plan))]
    parts = [shards.map_shard(path).record for path in paths]
    names, skipped, remarks = (
        [item for part in parts for item in part[key]]
        for key in ("names", "skipped", "remarks")
    )
    skipped = _show_pairs(skipped)
    remarks = _show_pairs([*source.list_remarks(), *remarks])
    source.write_split(folder)
    if progress:
        _tell("Skipped", skipped, len(models))
        _tell("Remarks on", remarks, len(models))
    if not names:
        for path in paths:
            path.unlink(missing_ok=True)
        raise ValueError(
            f"Expected at least one usable {source.unit} in {source.spec.folder}, but "
            f"none of {len(models)} is; look at the first: {skipped[0][1]}"
        )
    listed = [[p.name, p.stat().st_size, shards.checksum(p)] for p in paths]
    place = show_text(source.spec.folder)
    record |= {"folder": place, "names": names, "skipped": skipped}
    files.write_json(folder / RECORD, record | {"remarks": remarks, "shards": listed})


def _show_pairs(pairs):
    return tuple((show_text(name), show_text(text)) for name, text in pairs)


def _tell(title, pairs, count):
    if pairs:
        print(f"{title} {len(pairs)} of {count} models:")
        for name, text in pairs[:SHOWN]:
            print(f"  {name}: {text}")
    if len(pairs) > SHOWN:
        print(f"  and {len(pairs) - SHOWN} more; spec.json lists all")


def _count_cores():
    # As in render/devices.py, which this package does not import: it needs JAX.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def read_cache(folder: str | Path) -> DataSet:
    """Read a finished cache folder, once size and checksum of every shard are right.

    Raises:
      ValueError: naming the file, if the cache is unfinished or a file is damaged.
    """
    folder = Path(folder)
    path = folder / RECORD
    if not path.is_file():
        raise ValueError(
            f"Expected {path}, but the cache was never finished; prepare it again."
        )
    record = files.read_json(path)

    def check(entry):
        name, size, checksum = entry
        path = folder / Path(name).name  # never of another folder
        if not path.is_file() or path.stat().st_size != size:
            state = "missing or incomplete"
        elif shards.checksum(path) != checksum:
            state = "changed"
        else:
            return shards.map_shard(path)
        raise ValueError(
            f"Expected {path} as it was written, but it is {state}; prepare it again."
        )

    # zlib lets other threads run
    with concurrent.futures.ThreadPoolExecutor(_count_cores()) as pool:
        parts = [part for part in pool.map(check, record["shards"]) if part.arrays]
    pages = Pages([part.mapping for part in parts])
    arrays = {}
    for name in ROWS:
        having = [part for part in parts if name in part.arrays]
        counts = [n for part in having for n in part.record["counts"][name]]
        pieces = [part.arrays[name] for part in having]
        fits = len(having) == len(parts) and sum(counts) == sum(map(len, pieces))
        if having and not (fits and min(counts) >= 0):
            raise ValueError(
                f"Expected as many rows of {name} in all shards of {folder} as these "
                "say, but there are others; delete the folder."
            )
        arrays[name] = Stack(pieces, counts, pages) if having else None
    return DataSet(
        **arrays,
        names=tuple(map(show_text, record["names"])),
        skipped=_show_pairs(record["skipped"]),
        remarks=_show_pairs(record["remarks"]),
    )
