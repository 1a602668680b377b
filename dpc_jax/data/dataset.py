"""A data set on disk: prepared once, kept under a key of everything that made it.

A cache folder holds shards and, when all are there, `spec.json`, which lists them and
their models. Without it, preparing continues with the shards that are missing.
"""

import contextlib
import json
import os
from pathlib import Path
from typing import Any

from dpc_jax import files
from dpc_jax.config import ELEVATIONS
from dpc_jax.data import shards, workers
from dpc_jax.data.arrays import ROWS, DataSet, Pages, Stack
from dpc_jax.data.sources import open_source
from dpc_jax.data.spec import SUPERSAMPLE, DataSpec
from dpc_jax.outputs import show_text, telling_tenths

SHOWN = 20  # skipped models that are printed
VERSION = 4  # raise it when rendering, the procedural shapes or the shards change
RECORD = "spec.json"  # the file that finishes a cache


def load_or_render(
    spec: DataSpec, *, cache_dir: str | Path, processes: int | None = None
) -> DataSet:
    """The data set of a specification, from the cache or prepared now.

    Any number of processes may prepare one set in a shared folder.

    Args:
      cache_dir: folder of the caches; created where missing.
      processes: how many render at once; None for one per core. The result does not
        depend on it.

    Raises:
      ValueError: if there is no folder, no model, or none that can be used.
      OSError: if the disk is full or the cache cannot be written.
    """
    source, models, record, folder = _locate(spec, cache_dir)
    # not of the cache: what a split is called must not depend on when it was read
    warnings = tuple(source.list_warnings())
    if (folder / RECORD).exists():
        try:
            return read_cache(folder)._replace(warnings=warnings)
        except (OSError, ValueError) as error:
            print(f"The cache {folder} is damaged ({error}) and will be repaired.")
    plan = workers.plan_shards(folder, source, models)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files.remove_leftovers(folder)
        _prepare(plan, processes or len(os.sched_getaffinity(0)))
        _finish(plan, record)
    except OSError as error:
        if error.strerror is None:  # it is a sentence already
            raise
        raise OSError(
            f"Expected to write the data set to {folder}, but that failed "
            f"({error.strerror}); make room or set another data.cache_dir."
        ) from None
    finally:
        files.remove_leftovers(folder)
        with contextlib.suppress(OSError):  # it is not empty
            folder.rmdir()
    return read_cache(folder)._replace(warnings=warnings)


def _locate(spec, cache_dir):
    """Source, models, what determines their bytes as JSON, and their cache folder."""
    source = open_source(spec)
    models = source.list_models()
    # where the files lie does not affect the bytes
    record = {name: v for name, v in vars(spec).items() if name != "folder"}
    record |= {"elevation": ELEVATIONS, "supersample": SUPERSAMPLE}
    record |= {"extent": 1.0, "version": VERSION}  # of the image plane
    record["sources"] = [[m.name, m.seed, m.copy, m.digest] for m in models]
    record["sidecars"] = source.list_sidecars()
    key = files.digest_text(json.dumps(record, sort_keys=True))[:12]
    folder = Path(cache_dir) / f"{spec.category}-{spec.split}-{key}"
    return source, models, record, folder


def _prepare(plan, processes):
    """Make the shards that are missing."""
    folder, source, models, ranges = plan
    missing = [n for n in range(len(ranges)) if not plan.is_whole(n)]
    if not missing:
        return
    count = plan.count(missing)
    if count < len(models):
        print(f"Continuing in {folder}: {count} of {len(models)} models are missing.")
    results = workers.write_together(plan, missing, processes=processes)
    tell = telling_tenths(f"{source.work} {source.spec.split} {source.spec.category}")
    with contextlib.closing(results):
        for left in results:
            tell("models", count - left, count)


def _finish(plan, record):
    """Gather what the shards say of their models, and write the record of the set."""
    source, count = plan.source, len(plan.models)
    paths = [plan.locate(number) for number in range(len(plan.ranges))]
    parts = [shards.map_shard(path).record for path in paths]
    names, skipped, remarks = (
        [item for part in parts for item in part[key]]
        for key in ("names", "skipped", "remarks")
    )
    skipped = _show_pairs(skipped)
    remarks = _show_pairs([*source.remarks, *remarks])
    _tell("Skipped", skipped, count)
    _tell("Remarks on", remarks, count)
    if not names:
        for path in paths:
            path.unlink(missing_ok=True)
        raise ValueError(
            f"Expected at least one usable model in {source.spec.folder}, but "
            f"none of {count} is; look at the first: {skipped[0][1]}"
        )
    record |= {"folder": show_text(source.spec.folder), "names": names}
    record |= {"skipped": skipped, "remarks": remarks}
    record["shards"] = [path.name for path in paths]
    files.write_json(plan.folder / RECORD, record)


def _show_pairs(pairs):
    return tuple((show_text(name), show_text(text)) for name, text in pairs)


def _tell(title, pairs, count):
    if pairs:
        print(f"{title} {len(pairs)} of {count} models:")
        for name, text in pairs[:SHOWN]:
            print(f"  {name}: {text}")
    if len(pairs) > SHOWN:
        print(f"  and {len(pairs) - SHOWN} more; spec.json lists all")


def read_cache(folder: str | Path) -> DataSet:
    """Read a finished cache folder, once the checksums of all arrays are right.

    Raises:
      ValueError: naming the file, if the cache is unfinished or a file is damaged.
    """
    folder = Path(folder)
    path = folder / RECORD
    if not path.is_file():
        raise ValueError(
            f"Expected {path}, but the cache was never finished; prepare it again."
        )
    with files.reading("the record of a set", path, "prepare the set again"):
        record = files.read_json(path)
        paths = [folder / Path(name).name for name in record["shards"]]  # of no other
        names = tuple(map(show_text, record["names"]))
        skipped, remarks = (_show_pairs(record[key]) for key in ("skipped", "remarks"))
    try:
        parts = [shards.map_shard(path) for path in paths]
    except FileNotFoundError as error:
        raise ValueError(
            f"Expected {error.filename}, but it is missing; prepare the set again."
        ) from None
    if [name for part in parts for name in part.record["names"]] != record["names"]:
        raise ValueError(
            f"Expected shards of the models that {path} lists, but they hold others; "
            "prepare the set again."
        )
    parts = [part for part in parts if part.arrays]
    pages = Pages([part.mapping for part in parts])
    arrays: dict[str, Any] = dict.fromkeys(ROWS)
    for name in ROWS:
        if any(name in part.arrays for part in parts):
            models = [rows for part in parts for rows in part.split(name)]
            arrays[name] = Stack(models, pages)
    return DataSet(**arrays, names=names, skipped=skipped, remarks=remarks)
