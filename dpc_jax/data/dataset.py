"""A data set on disk: rendered once, kept under a key of everything that made it.

A cache folder holds one `.npy` file per array and `spec.json`, written under a
temporary name and renamed when whole; what bears the final name is complete.
"""

import hashlib
import json
import os
import shutil
import socket
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import rendering
from .sources import DataSpec as DataSpec
from .sources import list_sidecars, list_sources

VERSION = 1  # raise it when rendering or the procedural shapes change


class DataSet(NamedTuple):
    """Views of M models, V each, at S pixels; arrays are mapped from disk, read-only.

    images: uint8 [M, V, S, S, 3], on white. masks: uint8 [M, V, S, S], 255 = covered.
    depths: float32 [M, V, S, S], metric z from the camera, 0 where nothing is covered.
    quaternions: float32 [M, V, 4], wxyz, object to camera.
    surfaces: float32 [M, P, 3], points on the surface, for evaluation only.
    names: M names. skipped: (name, reason) of the models that were no use.
    """

    images: np.ndarray
    masks: np.ndarray
    depths: np.ndarray
    quaternions: np.ndarray
    surfaces: np.ndarray
    names: tuple
    skipped: tuple


def load_or_render(spec, *, cache_dir, processes=None, progress=True):
    """The data set of a specification, from the cache or rendered now.

    Args:
      spec: `DataSpec`.
      cache_dir: folder of the caches; created where missing.
      processes: how many render at once; None for one per core. The result does not
        depend on it.
      progress: whether to show progress and what was skipped on stdout.

    Returns:
      `DataSet`.

    Raises:
      ValueError: if there is no folder, no mesh file, or none of use.
    """
    sources = list_sources(spec)
    record = _describe(spec, sources)
    text = json.dumps(record, sort_keys=True)
    key = hashlib.sha256(text.encode()).hexdigest()[:12]
    folder = Path(cache_dir) / f"{spec.category}-{spec.split}-{key}"
    if folder.exists():
        try:
            return read_cache(folder)
        except (OSError, ValueError, KeyError, TypeError) as error:
            print(f"The cache {folder} is damaged ({error}); rendering again.")
    folder.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(folder)
    partial = folder.with_name(
        f"{folder.name}.{socket.gethostname()}.{os.getpid()}.tmp"
    )
    try:
        partial.mkdir()
        _render(partial, spec, sources, record, processes=processes, progress=progress)
        _publish(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return read_cache(folder)


def _describe(spec, sources):
    """Everything that determines the bytes, as JSON; the folder's place does not."""
    record = {k: v for k, v in vars(spec).items() if k != "folder"}
    record["version"] = VERSION
    record["sources"] = [[s.name, s.seed, s.copy, s.digest] for s in sources]
    record["sidecars"] = list_sidecars(spec)
    return record


def _render(partial, spec, sources, record, *, processes, progress):
    rendering.write_plan(partial, spec, sources)
    count = len(sources)
    processes = min(processes or _count_cores(), count)
    if processes == 1 or count <= rendering.INLINE:
        results = rendering.render_models(partial, range(count))
    else:
        results = rendering.render_in_processes(
            partial, count=count, processes=processes
        )
    label = f"Rendering {spec.split} {spec.category}"
    results = dict(
        rendering.follow(results, count=count, label=label, progress=progress)
    )
    skipped = [(sources[i].name, results[i]) for i in range(count) if results[i]]
    kept = [i for i in range(count) if results[i] is None]
    if skipped and progress:
        print(f"Skipped {len(skipped)} of {count} models:")
        for name, reason in skipped:
            print(f"  {name}: {reason}")
    if not kept:
        raise ValueError(
            f"expected at least one usable mesh in {spec.folder}, got none of {count}; "
            f"the first: {skipped[0][1]}"
        )
    if skipped:
        _drop_rows(partial, spec, kept)
    arrays = rendering.array_shapes(spec, len(kept))
    record = {
        **record,
        "folder": spec.folder,
        "names": [sources[i].name for i in kept],
        "skipped": skipped,
        "arrays": {
            name: [*shape_and_type, _checksum(partial / f"{name}.npy")]
            for name, shape_and_type in arrays.items()
        },
    }
    (partial / "plan.json").unlink()
    # last of all: a folder without it was never finished
    (partial / "spec.json").write_text(json.dumps(record, indent=1), encoding="utf-8")


def _count_cores():
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _drop_rows(partial, spec, kept):
    """Keeps only the rows of usable models, row by row: sets can exceed the memory."""
    for name, (shape, dtype) in rendering.array_shapes(spec, len(kept)).items():
        path, smaller = partial / f"{name}.npy", partial / f"{name}.kept.npy"
        old = np.load(path, mmap_mode="r")
        new = np.lib.format.open_memmap(smaller, mode="w+", dtype=dtype, shape=shape)
        for row, index in enumerate(kept):
            new[row] = old[index]
        new.flush()
        del old, new
        os.replace(smaller, path)


def _checksum(path):
    value = 0
    with open(path, "rb") as file:
        while block := file.read(1 << 22):
            value = zlib.crc32(block, value)
    return value


def _publish(partial, folder):
    """Gives the finished folder its name, in place of a damaged one or of none."""
    try:
        os.rename(partial, folder)
        return
    except OSError:
        pass  # the name is taken: by a damaged cache, or by a whole one made meanwhile
    try:
        read_cache(folder)
    except (OSError, ValueError, KeyError, TypeError):
        damaged = partial.with_suffix(".damaged")
        os.rename(folder, damaged)
        os.rename(partial, folder)
        shutil.rmtree(damaged, ignore_errors=True)


def _remove_leftovers(folder):
    """Removes what a process of this machine left when killed while rendering."""
    host = socket.gethostname()
    for path in folder.parent.glob(f"{folder.name}.{host}.*"):
        pid = path.name.split(".")[-2]
        if pid.isdigit() and int(pid) != os.getpid() and not _is_alive(int(pid)):
            shutil.rmtree(path, ignore_errors=True)


def _is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def read_cache(folder):
    """Reads a finished cache folder.

    Raises:
      ValueError: naming the file, if the cache is unfinished or a file is damaged.
    """
    folder = Path(folder)
    path = folder / "spec.json"
    if not path.is_file():
        raise ValueError(f"expected {path}, found none; the cache was never finished.")
    record = json.loads(path.read_text(encoding="utf-8"))
    arrays = {}
    for name, (shape, dtype, checksum) in record["arrays"].items():
        path = folder / f"{name}.npy"
        if not path.is_file() or _checksum(path) != checksum:
            raise ValueError(
                f"expected {path} as it was written, it is missing or changed"
            )
        arrays[name] = np.load(path, mmap_mode="r")
        if arrays[name].shape != tuple(shape) or arrays[name].dtype != dtype:
            raise ValueError(
                f"expected {dtype} {tuple(shape)} in {path}, got {arrays[name].dtype} "
                f"{arrays[name].shape}"
            )
    skipped = tuple((name, reason) for name, reason in record["skipped"])
    return DataSet(**arrays, names=tuple(record["names"]), skipped=skipped)
