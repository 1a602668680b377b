"""A data set on disk: prepared once, kept under a key of everything that made it.

A cache folder holds shards, each written under a temporary name and renamed when whole,
and last of all `spec.json`, which lists them with size and checksum: a folder without
it was never finished, and preparing goes on with the shards that are missing.
"""

import concurrent.futures
import contextlib
import hashlib
import json
import os
import shutil
import socket
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dpc_jax.data import rendering, shards
from dpc_jax.data.spec import DataSpec as DataSpec
from dpc_jax.data.spec import list_sidecars, list_sources, split_files

SHOWN = 20  # skipped models that are printed
VERSION = 2  # raise it when rendering, the procedural shapes or the shards change
PLACES = ("folder", "split_file", "ground_truth")  # do not determine the bytes


class DataSet(NamedTuple):
    """Views of M models at S pixels; arrays lie on disk and are read when indexed.

    Arrays are `shards.Stack`s, which read like the arrays below, or plain arrays. Where
    models differ in their number of views, V is the largest and `counts` tells.

    images: uint8 [M, V, S, S, 3], on white. masks: uint8 [M, V, S, S], 255 = covered.
    depths: float32 [M, V, S, S], metric z from the camera, 0 where nothing is covered;
        None for own images.
    quaternions: float32 [M, V, 4], wxyz, object to camera; None where not given.
    surfaces: float32 [M, P, 3], points on the surface, for evaluation only; models may
        differ in P; None where there is no ground truth.
    names: M names. skipped: (name, reason) of the models that were no use.
    remarks: (name, remark) of what was used but lacks something.
    """

    images: np.ndarray
    masks: np.ndarray
    depths: np.ndarray | None
    quaternions: np.ndarray | None
    surfaces: np.ndarray | None
    names: tuple
    skipped: tuple
    remarks: tuple = ()

    @property
    def counts(self):
        """[M] number of views of each model."""
        counts = getattr(self.masks, "counts", None)
        return np.full(*self.masks.shape[:2]) if counts is None else counts


def load_or_render(spec, *, cache_dir, processes=None, progress=True):
    """The data set of a specification, from the cache or prepared now.

    Args:
      spec: `DataSpec`.
      cache_dir: folder of the caches; created where missing.
      processes: how many render at once; None for one per core. The result does not
        depend on it.
      progress: whether to show progress and what was skipped on stdout.

    Returns:
      `DataSet`.

    Raises:
      ValueError: if there is no folder, no model, or none of use.
      OSError: if the disk is full or the cache cannot be written.
    """
    sources = list_sources(spec)
    record = _describe(spec, sources)
    folder = _locate(spec, record, cache_dir)
    if (folder / "spec.json").exists():
        try:
            return read_cache(folder)
        except (OSError, ValueError, KeyError, TypeError) as error:
            print(f"The cache {folder} is damaged ({error}); what is, is made again.")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        _remove_leftovers(folder)
        _prepare(folder, spec, sources, processes=processes, progress=progress)
        _finish(folder, spec, sources, record, progress=progress)
    finally:
        _remove_leftovers(folder)
        if not any(folder.iterdir()):
            folder.rmdir()
    return read_cache(folder)


def locate_cache(spec, sources, cache_dir):
    """The folder that the cache of a specification has, there or not."""
    return _locate(spec, _describe(spec, sources), cache_dir)


def _locate(spec, record, cache_dir):
    text = json.dumps(record, sort_keys=True)
    key = hashlib.sha256(text.encode()).hexdigest()[:12]
    return Path(cache_dir) / f"{spec.category}-{spec.split}-{key}"


def _describe(spec, sources):
    """Everything that determines the bytes, as JSON; the folder's place does not."""
    record = {k: v for k, v in vars(spec).items() if k not in PLACES}
    record["version"] = VERSION
    record["sources"] = [[s.name, s.seed, s.copy, s.digest] for s in sources]
    record["sidecars"] = list_sidecars(spec)
    return record


def _prepare(folder, spec, sources, *, processes, progress):
    """Writes the shards that are missing or damaged."""
    plan = rendering.plan_shards(spec, sources)
    missing = []
    for number in range(len(plan)):
        path = folder / rendering.name_shard(number)
        try:
            record = shards.read_record(path)
            expected = rendering.identify_shard(folder, plan[number])
            if {name: record.get(name) for name in expected} != expected:
                raise ValueError("it is one of another set or of other models")
        except FileNotFoundError:
            missing.append(number)
        except (OSError, ValueError) as error:
            print(f"The shard {path} is damaged ({error}); it is made again.")
            missing.append(number)
    if not missing:
        return
    count = sum(len(plan[number]) for number in missing)
    if 0 < len(missing) < len(plan) and progress:
        print(f"Going on in {folder}: {count} of {len(sources)} models are missing.")
    needed = sum(
        rendering.estimate_bytes(spec, sources[i]) for n in missing for i in plan[n]
    )
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise OSError(
            f"expected {needed / 1e9:.1f} GB free for {folder}, there are "
            f"{free / 1e9:.1f}; free some or give another data.cache_dir."
        )
    processes = processes or _count_cores()
    if processes == 1 or count <= rendering.INLINE:
        results = rendering.write_shards(folder, spec, sources, missing)
    else:
        results = rendering.render_in_processes(
            folder, spec, sources, missing, processes=processes
        )
    label = f"Rendering {spec.split} {spec.category}"
    with contextlib.closing(results):
        shown = rendering.follow(results, count=count, label=label, progress=progress)
        for _ in shown:
            pass


def _finish(folder, spec, sources, record, *, progress):
    """Writes `spec.json` from the records of all shards."""
    paths = [
        folder / rendering.name_shard(number)
        for number in range(len(rendering.plan_shards(spec, sources)))
    ]
    parts = [shards.map_shard(path).record for path in paths]
    names = [name for part in parts for name in part["names"]]
    skipped = [pair for part in parts for pair in part["skipped"]]
    remarks = [pair for part in parts for pair in part["remarks"]]
    if spec.folder is not None and spec.kind != "meshes":
        remarks = [*_write_split(folder, spec), *remarks]
    if progress:
        _tell("Skipped", skipped, len(sources))
        _tell("Remarks on", remarks, len(sources))
    if not names:
        kind = "mesh" if spec.kind in ("meshes", "shapenet") else "object"
        for path in paths:
            path.unlink()
        raise ValueError(
            f"expected at least one usable {kind} in {spec.folder}, got none of "
            f"{len(sources)}; the first: {skipped[0][1]}"
        )
    record = {
        **record,
        "folder": spec.folder,
        "names": names,
        "skipped": skipped,
        "remarks": remarks,
        "shards": [[p.name, p.stat().st_size, shards.checksum(p)] for p in paths],
    }
    partial = folder / f"spec.json.{socket.gethostname()}.{os.getpid()}.tmp"
    partial.write_text(json.dumps(record, indent=1), encoding="utf-8")
    os.replace(partial, folder / "spec.json")


def _write_split(folder, spec):
    """Writes a seeded split beside the cache; remarks on the set as a whole."""
    from dpc_jax.data.sets import listings, split_lists

    catalog = listings.open_catalog(spec, split_files=split_files)
    remarks = listings.list_remarks(spec, catalog)
    if catalog.official is None:
        text = json.dumps(catalog.sides, sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:12]
        path = folder.with_name(f"{spec.category}-split-{key}.csv")
        split_lists.write_split(path, catalog.sides, catalog.synset)
    return remarks


def _tell(title, pairs, count):
    if pairs:
        print(f"{title} {len(pairs)} of {count} models:")
        for name, text in pairs[:SHOWN]:
            print(f"  {name}: {text}")
        if len(pairs) > SHOWN:
            print(f"  and {len(pairs) - SHOWN} more; spec.json lists all")


def _count_cores():
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _remove_leftovers(folder):
    """Removes what this process, or one of this machine that died, left unfinished."""
    host = socket.gethostname()
    for path in folder.glob(f"*.{host}.*.tmp"):
        pid = path.name.split(".")[-2]
        if pid.isdigit() and (int(pid) == os.getpid() or not _is_alive(int(pid))):
            path.unlink(missing_ok=True)


def _is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def read_cache(folder):
    """Reads a finished cache folder, once size and checksum of every shard are right.

    Raises:
      ValueError: naming the file, if the cache is unfinished or a file is damaged.
    """
    folder = Path(folder)
    path = folder / "spec.json"
    if not path.is_file():
        raise ValueError(f"expected {path}, found none; the cache was never finished.")
    record = json.loads(path.read_text(encoding="utf-8"))

    def check(entry):
        name, size, checksum = entry
        path = folder / name
        if not path.is_file() or path.stat().st_size != size:
            raise ValueError(f"expected {path} with {size} bytes, it is gone or cut")
        if shards.checksum(path) != checksum:
            raise ValueError(f"expected {path} as it was written, it is changed")
        return shards.map_shard(path)

    # zlib lets other threads run
    with concurrent.futures.ThreadPoolExecutor(_count_cores()) as pool:
        parts = [part for part in pool.map(check, record["shards"]) if part.arrays]
    pages = shards.Pages([part.mapping for part in parts])
    arrays = {}
    for name in ("images", "masks", "depths", "quaternions", "surfaces"):
        have = [name in part.arrays for part in parts]
        if any(have) != all(have):
            raise ValueError(f"expected {name} in all shards of {folder} or in none")
        arrays[name] = None
        if any(have):
            counts = [n for part in parts for n in part.record["counts"][name]]
            pieces = [part.arrays[name] for part in parts]
            arrays[name] = shards.Stack(pieces, counts, pages)
    skipped = tuple((name, reason) for name, reason in record["skipped"])
    remarks = tuple((name, remark) for name, remark in record["remarks"])
    return DataSet(
        **arrays, names=tuple(record["names"]), skipped=skipped, remarks=remarks
    )
