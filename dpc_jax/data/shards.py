"""Shards: the files of a data set, each written, checked and mapped on its own.

A shard holds whole models. It is an uncompressed `.npz`, so `numpy.load` reads it and
the archive itself keeps a size and a checksum of every array; because nothing is
compressed, the arrays can also be mapped where they lie.
"""

import contextlib
import errno
import io
import json
import math
import mmap
import os
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax import files
from dpc_jax.data.arrays import ROWS
from dpc_jax.files import Damage

RECORD = "record"  # member that says what the shard holds, as JSON
KEPT_PAGES = 32 << 20  # bytes read before mapped pages are given back to the system


class Shard(NamedTuple):
    """One mapped shard: arrays by name, read-only, and its record."""

    arrays: dict[str, np.ndarray]
    record: dict[str, Any]
    mapping: mmap.mmap


def write_shard(path: Path, arrays: dict[str, np.ndarray], record: dict[str, Any]):
    """Write arrays and a JSON record under a temporary name; rename it when whole."""
    text = np.frombuffer(json.dumps(record).encode(), dtype=np.uint8)
    try:
        with files.replacing(path) as partial, open(partial, "wb") as file:
            np.savez(file, **dict[str, Any](arrays | {RECORD: text}))
    except OSError as error:
        raise OSError(
            f"Expected to write {path}, but that failed ({error.strerror or error}); "
            "make room or give another folder."
        ) from None


def read_record(path: str | os.PathLike) -> dict[str, Any]:
    """The record of a shard whose every array is as it was written.

    Raises: as `map_shard`, and ValueError where a checksum differs.
    """
    with _naming_damage(path):
        shard, members = _map(path)
        for member in members:
            start, stop = _find_content(shard.mapping, member)
            with memoryview(shard.mapping)[start:stop] as content:
                if zlib.crc32(content) != member.CRC:
                    raise Damage(f"the checksum of {member.filename} differs")
    return shard.record


def map_shard(path: str | os.PathLike) -> Shard:
    """Map the arrays of a shard; only their places in the file are read yet.

    Nothing is mapped but the arrays of `arrays.ROWS` with the types and shapes that
    they have there, because the file may be a stranger's.

    Raises:
      OSError: if the file cannot be opened.
      ValueError: naming the file, if it is anything but such a shard.
    """
    with _naming_damage(path):
        return _map(path)[0]


@contextlib.contextmanager
def _naming_damage(path):
    """Name a file that is no shard as it was written, whatever it is."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.EINVAL:  # a seek to where nothing can be
            raise
        raise _refuse(path, "it is cut") from None
    except Exception as error:  # zipfile and numpy raise anything at all on damage
        raise _refuse(path, error) from None


def _refuse(path, reason):
    return ValueError(
        f"Expected {path} as it was written, but it is damaged ({reason}); delete it."
    )


def _map(path):
    """A shard and the members of its archive."""
    with files.open_regular(path) as file:
        mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
    arrays = {
        member.filename.removesuffix(".npy"): _map_array(mapping, member)
        for member in members
    }
    record = json.loads(arrays.pop(RECORD).tobytes())
    if not isinstance(record, dict):
        raise Damage(f"its record is {type(record).__name__}")
    return Shard(arrays, record, mapping), members


def _find_content(mapping, member):
    """Where a member's `.npy` file begins and ends."""
    # a member is a header of 30 bytes, its name, an extra field, and the .npy file
    offset = member.header_offset
    name_length, extra_length = struct.unpack_from("<HH", mapping, offset + 26)
    start = offset + 30 + name_length + extra_length
    stop = start + member.file_size
    is_whole = 0 <= offset and stop <= len(mapping)
    if not is_whole or member.compress_type != zipfile.ZIP_STORED:
        raise Damage(f"{member.filename} does not lie in it as it is")
    return start, stop


def _map_array(mapping, member):
    start, stop = _find_content(mapping, member)
    head = io.BytesIO(mapping[start : min(start + 1024, stop)])
    if np.lib.format.read_magic(head) != (1, 0):
        raise Damage(f"{member.filename} is of another version")
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(head)
    name = member.filename.removesuffix(".npy")
    kind, row = ("|u1", ()) if name == RECORD else ROWS[name]
    fits = len(shape) == 1 + len(row) and all(
        size >= 0 and size == (expected or size)
        for size, expected in zip(shape, (0, *row), strict=True)
    )
    if dtype.str != kind or not fits or is_fortran:
        raise Damage(f"{name} is {dtype} {shape}")
    if math.prod(shape) * dtype.itemsize != stop - start - head.tell():
        raise Damage(f"{name} {shape} is not what it has bytes for")
    return np.ndarray(shape, kind, buffer=mapping, offset=start + head.tell())


def checksum(path: str | os.PathLike) -> int:
    """CRC-32 of a file."""
    value = 0
    with files.open_regular(path) as file:
        while block := file.read(1 << 22):
            value = zlib.crc32(block, value)
    return value


class Pages:
    """Releases mapped pages after enough has been read, so that memory stays small.

    The system would keep them as long as it has room, and would count a process that
    has read 3 GB as 3 GB larger. A page that is wanted again comes from the file cache.
    """

    def __init__(self, mappings: Sequence[mmap.mmap]):
        self._mappings = mappings
        self._read = 0

    def count(self, size: int):
        """Note that `size` bytes were read."""
        self._read += size
        if self._read > KEPT_PAGES and hasattr(mmap, "MADV_DONTNEED"):
            self._read = 0
            for mapping in self._mappings:
                mapping.madvise(mmap.MADV_DONTNEED)


class Stack(np.lib.mixins.NDArrayOperatorsMixin):
    """Rows of many models over several shards, addressed by model and row.

    It reads like an array [M, V, ...] of which model m has only `counts[m]` rows:
    `stack[m]` is an array [counts[m], ...], `stack[m, v]` one row, and
    `stack[models, rows]` gathers rows into memory, for index arrays of like shapes.
    `shape[1]` is the largest count. Where all counts agree, everything else that an
    array can do works too, by reading the whole into memory.
    """

    def __init__(
        self,
        pieces: Sequence[np.ndarray],
        counts: Sequence[int],
        pages: Pages | None = None,
    ):
        """pieces: the row arrays [R, ...] of the shards, in order; counts: [M]."""
        self.counts = np.asarray(counts, dtype=np.int64)
        self._pieces = pieces
        self._pages = pages or Pages([])
        self._starts = np.concatenate([[0], np.cumsum(self.counts)])
        self._edges = np.concatenate([[0], np.cumsum([len(p) for p in pieces])])
        largest = int(self.counts.max(initial=0))
        self.shape = (len(self.counts), largest, *pieces[0].shape[1:])
        self.dtype = pieces[0].dtype

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def is_ragged(self) -> bool:
        """Whether models differ in their number of rows."""
        return bool((self.counts != self.shape[1]).any())

    def __len__(self):
        return len(self.counts)

    def __iter__(self):
        return (self[model] for model in range(len(self)))

    def __getitem__(self, key):
        model, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(model, int | np.integer):
            return self._read_model(model)[tuple(rest)]
        if isinstance(key, slice):
            return self._join(range(len(self))[key])
        if isinstance(key, tuple) and len(key) == 2:
            first, second = (np.asarray(part) for part in key)
            if first.dtype.kind in "iu" and second.dtype.kind in "iu":
                return self._gather(first, second)
        return np.asarray(self)[key]

    def __array__(self, dtype=None, copy=None):
        if copy is False:
            raise ValueError(
                "copy must be None or True for rows in several files, but it is False; "
                "allow the copy."
            )
        return np.asarray(self._join(range(len(self))), dtype=dtype)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        inputs = [np.asarray(x) if isinstance(x, Stack) else x for x in inputs]
        return getattr(ufunc, method)(*inputs, **options)

    def _read_model(self, model):
        if not -len(self) <= model < len(self):
            raise IndexError(f"model {model} of {len(self)}")
        model = model % len(self)
        start, stop = self._starts[model : model + 2]
        shard = np.searchsorted(self._edges, start, "right") - 1
        shard = min(shard, len(self._pieces) - 1)  # a last model without rows
        rows = self._pieces[shard][start - self._edges[shard] :][: stop - start]
        self._pages.count(rows.nbytes)
        return rows

    def _join(self, models):
        if self.is_ragged:
            raise ValueError(
                "Expected models with equal numbers of rows, but they have "
                f"{self.counts.min()} to {self.counts.max()}; read them one by one."
            )
        out = np.empty((len(models), *self.shape[1:]), self.dtype)
        for place, model in enumerate(models):
            out[place] = self._read_model(model)
        return out

    def _gather(self, models, rows):
        models, rows = np.broadcast_arrays(models, rows)
        if not ((models >= 0) & (models < len(self)) & (rows >= 0)).all():
            raise IndexError(f"models of {len(self)} and rows counted from 0")
        if (rows >= self.counts[models]).any():
            raise IndexError("a row beyond the last of its model")
        places = (self._starts[models] + rows).ravel()
        shards = np.searchsorted(self._edges, places, "right") - 1
        out = np.empty((*models.shape, *self.shape[2:]), self.dtype)
        flat = out.reshape(-1, *self.shape[2:])
        rows = places - self._edges[shards]
        for i, (shard, row) in enumerate(np.stack([shards, rows], 1).tolist()):
            flat[i] = self._pieces[shard][row]
        self._pages.count(out.nbytes)
        return out
