"""Shards on disk and the arrays that lie over several of them."""

import mmap
from pathlib import Path

import numpy as np
import pytest

from dpc_jax.data import arrays, shards


def make_stack(counts):
    """A ragged array as a list of models, and as a stack."""
    rng = np.random.default_rng(0)
    models = [rng.integers(0, 255, (count, 2, 3), np.uint8) for count in counts]
    return models, arrays.Stack(models)


def test_a_stack_reads_like_an_array():
    models, stack = make_stack([4] * 5)
    whole = np.stack(models)
    assert (stack.shape, stack.dtype, len(stack)) == (whole.shape, np.uint8, 5)
    keys = [
        0, -1, np.int64(3), (2, 1), (np.int64(1), 0, 1), (4, slice(1, 3)),
        slice(1, 4), slice(None, None, 2), (np.array([3, 0, 4]), np.array([1, 3, 0])),
        (np.array([[3], [0]]), np.array([[1, 3], [0, 0]])), whole > 100, ..., (..., 0),
    ]  # fmt: skip
    for key in keys:
        np.testing.assert_array_equal(stack[key], whole[key])
    np.testing.assert_array_equal(stack, whole)
    assert stack[[1, 2], [0, 0]].dtype == np.uint8


def test_models_of_a_ragged_stack_keep_their_rows():
    models, stack = make_stack([3, 0, 1, 5, 0, 2])
    assert stack.shape == (6, 5, 2, 3)
    for read, model in zip(stack, models, strict=True):
        np.testing.assert_array_equal(read, model)
    np.testing.assert_array_equal(
        stack[np.array([5, 3, 0]), np.array([1, 4, 2])],
        [models[5][1], models[3][4], models[0][2]],
    )
    for model, row in ((0, 3), (6, 0), (-1, 0), (0, -1)):
        with pytest.raises(IndexError):
            stack[np.array([model]), np.array([row])]
    with pytest.raises(ValueError, match="equal numbers of rows, but they have 0 to 5"):
        np.asarray(stack)
    with pytest.raises(IndexError):
        stack[6]


def test_what_is_written_is_mapped_and_numpy_reads_it(tmp_path):
    rng = np.random.default_rng(0)
    written = {
        "images": rng.integers(0, 255, (3, 5, 5, 3), np.uint8),
        "depths": rng.normal(size=(3, 5, 5)).astype(np.float32),
        "surfaces": np.zeros((0, 3), np.float32),
    }
    path = tmp_path / "shard-00000.npz"
    record = {"names": ["ä"], "counts": {n: [len(a)] for n, a in written.items()}}
    shards.write_shard(path, written, record)
    shard = shards.map_shard(path)
    assert shard.record == record
    with np.load(path) as loaded:
        for name, array in written.items():
            np.testing.assert_array_equal(shard.arrays[name], array, strict=True)
            np.testing.assert_array_equal(loaded[name], array, strict=True)
            assert not shard.arrays[name].flags.writeable
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_reading_a_large_set_needs_little_memory(tmp_path, monkeypatch):
    """A process that has read 40 MB twice holds a fraction of it."""
    monkeypatch.setattr(arrays, "KEPT_PAGES", 8 << 20)
    rows = np.random.default_rng(0).integers(0, 255, (40, 1 << 10, 1 << 10), np.uint8)
    path = tmp_path / "shard-0.npz"
    shards.write_shard(path, {"masks": rows}, {"names": "a", "counts": {"masks": [40]}})
    part = shards.map_shard(path)
    pages = arrays.Pages([part.mapping])
    stack = arrays.Stack(np.split(part.arrays["masks"], 10), pages)
    held = []
    for step in range(20):
        stack[np.full(4, step % 10), np.arange(4)]
        resident = Path("/proc/self/statm").read_text().split()[1]
        held.append(int(resident) * mmap.PAGESIZE >> 20)
    # 8 MB are kept before pages are given back, and a batch of 4 MB is in hand
    assert max(held) - held[0] < 20, held
