"""Shards: the files of a data set, each written, checked and mapped on its own.

A shard holds whole models. It is an uncompressed `.npz`, so `numpy.load` reads it and
the archive itself keeps a size and a checksum of every array; because nothing is
compressed, the arrays can also be mapped where they lie.
"""

import io
import json
import math
import mmap
import os
import struct
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax import files
from dpc_jax.data.arrays import ROWS
from dpc_jax.files import Damage

RECORD = "record"  # member that says what the shard holds, as JSON


class Shard(NamedTuple):
    """One mapped shard: arrays by name, read-only, and its record."""

    arrays: dict[str, np.ndarray]
    record: dict[str, Any]
    mapping: mmap.mmap

    def split(self, name: str) -> list[np.ndarray]:
        """The rows of an array by model."""
        return np.split(self.arrays[name], np.cumsum(self.record["counts"][name])[:-1])


def write_shard(path: Path, arrays: dict[str, np.ndarray], record: dict[str, Any]):
    """Write arrays and a JSON record under a temporary name; rename it when whole.

    The record has the "names" of the models, and in "counts" by the name of each array
    how many of its rows belong to each model.
    """
    text = np.frombuffer(json.dumps(record).encode(), dtype=np.uint8)
    with files.replacing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **dict[str, Any](arrays | {RECORD: text}))


def map_shard(path: str | os.PathLike) -> Shard:
    """Map the arrays of a shard, once the checksum of each is right.

    Nothing is mapped but the arrays of `arrays.ROWS` with the types and shapes that
    they have there, because the file may be a stranger's.

    Raises:
      OSError: if the file cannot be opened.
      ValueError: naming the file, if it is anything but such a shard.
    """
    arrays = {}
    with (
        files.open_regular(path) as file,
        files.reading("a shard as it was written", path, "delete it"),
        zipfile.ZipFile(file) as archive,
    ):
        mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            arrays[name] = _map_array(mapping, member, name)
        if name := archive.testzip():
            raise Damage(f"the checksum of {name} differs")
        record = json.loads(arrays.pop(RECORD).tobytes())
        models = len(record["names"])
        for name, array in arrays.items():
            counts = record["counts"][name]
            if len(counts) != models or sum(counts) != len(array) or min(counts) < 0:
                raise Damage(f"{name} has {len(array)} rows, the record {counts}")
        return Shard(arrays, record, mapping)


def _map_array(mapping, member, name):
    # a member is a header of 30 bytes, its name, an extra field, and the .npy file
    offset = member.header_offset
    name_length, extra_length = struct.unpack_from("<HH", mapping, offset + 26)
    start = offset + 30 + name_length + extra_length
    stop = start + member.file_size
    is_whole = 0 <= offset and stop <= len(mapping)
    if not is_whole or member.compress_type != zipfile.ZIP_STORED:
        raise Damage(f"{name} does not lie in it as it is")
    head = io.BytesIO(mapping[start : min(start + 1024, stop)])
    if np.lib.format.read_magic(head) != (1, 0):
        raise Damage(f"{name} is of another version")
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(head)
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
