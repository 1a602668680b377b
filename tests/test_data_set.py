"""The data set on disk: whole or absent, the same for any number of processes.

Also of processes that know nothing of each other and share a folder.
"""

import fcntl
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import numpy as np
import pytest
import trimesh
from data_trees import rotate, share_inside, write_boxes

from dpc_jax.data import DataSpec, dataset, load_or_render, views, workers
from dpc_jax.files import locate_claim

SMALL = dict(category="car", models=3, views=2, image_size=16, surface_points=50)
ARRAYS = ("images", "masks", "depths", "quaternions", "surfaces")


def load(cache, *, processes=1, **changes):
    spec = DataSpec(**{**SMALL, **changes})
    return load_or_render(spec, cache_dir=cache, processes=processes)


def assert_same(first, second):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.names == second.names and first.skipped == second.skipped


def assert_same_files(first, second):
    """Folders of caches with the same files, byte by byte."""
    paths = [p.relative_to(first) for p in first.glob("*/*")]
    assert sorted(paths) == sorted(p.relative_to(second) for p in second.glob("*/*"))
    for path in paths:
        assert (first / path).read_bytes() == (second / path).read_bytes(), path


def test_a_set_holds_what_it_says(tmp_path):
    data = load(tmp_path, image_size=32)
    assert data.images.shape == (3, 2, 32, 32, 3) and data.images.dtype == np.uint8
    assert data.masks.shape == (3, 2, 32, 32) and data.masks.dtype == np.uint8
    assert data.depths.shape == (3, 2, 32, 32) and data.depths.dtype == np.float32
    assert data.quaternions.shape == (3, 2, 4) and data.surfaces.shape == (3, 50, 3)
    covered = np.asarray(data.masks) > 0
    assert covered.any(axis=(2, 3)).all()
    # the object lies within 0.5 of its centre, the camera at 2
    assert (np.abs(data.depths[covered] - 2.0) < 0.5).all()
    assert (data.depths[~covered] == 0).all()
    assert not data.images[0].flags.writeable
    for model, view in np.ndindex(3, 2):
        pose, mask = data.quaternions[model, view], data.masks[model, view]
        # a point at the rim can fall between the samples of its pixel
        assert share_inside(data.surfaces[model], pose, mask) > 0.97
        assert abs(rotate(pose)[0, 2]) < 1e-6  # upright


def test_any_number_of_processes_gives_the_same_bytes(tmp_path, monkeypatch):
    load(tmp_path / "alone", models=9)  # in three shards
    monkeypatch.setattr(workers, "INLINE", 0)
    check = "\nimport sys; assert 'jax' not in sys.modules, 'a worker loaded jax'"
    monkeypatch.setattr(workers, "BOOT", workers.BOOT + check)
    load(tmp_path / "two", processes=2, models=9)
    assert_same_files(tmp_path / "alone", tmp_path / "two")


def test_the_shard_of_a_killed_process_is_taken_over(tmp_path):
    load(tmp_path / "alone", models=20)  # in five shards
    (whole,) = (tmp_path / "alone").iterdir()
    folder = tmp_path / "shared" / whole.name
    folder.mkdir(parents=True)
    claim = open(locate_claim(folder / "shard-00001.npz"), "w")
    fcntl.flock(claim, fcntl.LOCK_EX)  # as another process would
    with ThreadPoolExecutor() as pool:
        loading = pool.submit(load, tmp_path / "shared", models=20)
        while len(list(folder.glob("*.npz"))) < 4:
            assert not loading.done()
        claim.close()  # as the system does when it kills a process
    loading.result()
    assert_same_files(tmp_path / "alone", tmp_path / "shared")


def test_where_the_disk_knows_no_locks_everything_is_still_made(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("fcntl.flock", refuse)
    assert len(load(tmp_path, models=9).names) == 9


def test_a_worker_that_fails_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "INLINE", 0)
    monkeypatch.setattr(workers, "BOOT", "import sys; sys.exit('out of luck')")
    with pytest.raises(ChildProcessError, match=r"(?s)status 1;.*out of luck"):
        load(tmp_path, processes=2, models=9)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_ends_the_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "INLINE", 0)
    started = []
    original = subprocess.Popen

    def record(*args, **options):
        started.append(original(*args, **options))
        return started[-1]

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", record)
    monkeypatch.setattr(dataset, "telling_tenths", lambda _: interrupt)
    with pytest.raises(KeyboardInterrupt):
        load(tmp_path, processes=2, models=400)
    assert len(started) == 2
    # Ended, by the signal or by the pipe that broke before it came.
    assert all(worker.poll() is not None for worker in started)
    # Whole shards stay, to go on from; nothing says that the set is whole.
    left = [path.name for path in tmp_path.rglob("*")]
    assert "spec.json" not in left and not [n for n in left if n.endswith(".tmp")]


def test_workers_of_a_killed_process_end_with_their_shard(tmp_path):
    spec = SMALL | {"models": 200, "views": 20}  # 16 shards of half a second
    code = f"""
from dpc_jax.data import DataSpec, load_or_render
load_or_render(DataSpec(**{spec}), cache_dir={str(tmp_path)!r}, processes=2)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)
    while not list(tmp_path.rglob("shard-*.npz")):
        assert parent.poll() is None
        time.sleep(0.05)
    parent.kill()
    parent.wait()
    idle = 0
    while idle < 3:  # between two shards, a worker claims none for a moment
        time.sleep(0.2)
        idle = 0 if list(tmp_path.rglob(".*.claim")) else idle + 1
    assert len(list(tmp_path.rglob("shard-*.npz"))) < 8


def test_an_interrupted_set_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    """What a killed process has left half written is removed and never read."""
    whole = load(tmp_path / "unbroken", models=9)
    # In the second shard, which has four models.
    turns = [*6 * [mock.DEFAULT], KeyboardInterrupt, *5 * [mock.DEFAULT]]
    calls = mock.Mock(wraps=views.sample_surface, side_effect=turns)
    monkeypatch.setattr(views, "sample_surface", calls)
    with pytest.raises(KeyboardInterrupt):
        load(tmp_path / "broken", models=9)
    (folder,) = (tmp_path / "broken").iterdir()
    assert [path.name for path in folder.iterdir()] == ["shard-00000.npz"]
    with pytest.raises(ValueError, match="never finished"):
        dataset.read_cache(folder)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (folder / f".{os.uname().nodename}.{dead.pid}.0.tmp").write_bytes(b"PK")
    assert_same(whole, load(tmp_path / "broken", models=9))
    assert calls.call_count == 7 + 5 and not list(folder.glob("*.tmp"))
    assert "5 of 9 models are missing" in capsys.readouterr().out


@pytest.mark.parametrize("harm", ["flip", "gone", "swapped", "nonsense"])
def test_a_damaged_cache_is_named_and_only_that_is_made_again(
    tmp_path, capsys, monkeypatch, harm
):
    whole = load(tmp_path, models=9)
    renders = mock.Mock(wraps=views.render_view)
    monkeypatch.setattr(views, "render_view", renders)
    (folder,) = tmp_path.iterdir()
    path = folder / "shard-00001.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    if harm == "nonsense":
        (folder / "spec.json").write_text("{")
    else:
        path.unlink()  # a new file: the old one is still mapped
    if harm == "flip":
        path.write_bytes(content)
    elif harm == "swapped":
        path.write_bytes((folder / "shard-00000.npz").read_bytes())
    assert_same(whole, load(tmp_path, models=9))
    text = capsys.readouterr().out
    assert "is damaged" in text
    rendered = 0 if harm == "nonsense" else 4 * 2  # the views of one shard
    assert renders.call_count == rendered
    assert harm == "nonsense" or "shard-00001.npz" in text
    assert len(list(tmp_path.iterdir())) == 1
    load(tmp_path, models=9)
    assert renders.call_count == rendered
    assert "is damaged" not in capsys.readouterr().out


def test_unusable_meshes_are_skipped_named_and_counted(tmp_path, capsys):
    folder = write_boxes(tmp_path / "meshes", 3)
    (folder / "broken.stl").write_bytes(b"\x00\x01")
    (folder / "box1b.obj").write_text("v 0 0 0\n")
    options = dict(folder=str(folder), models=None, split="test", fractions=(0, 0, 1))
    data = load(tmp_path / "cache", **options)
    assert data.names == ("box0.ply", "box1.ply", "box2.ply")
    assert sorted(name for name, _ in data.skipped) == ["box1b.obj", "broken.stl"]
    text = capsys.readouterr().out
    assert "Skipped 2 of 5" in text and "broken.stl" in text
    # rows were moved together: each model's views are its own
    widths = np.ptp(data.surfaces, axis=1)
    ratio = widths[:, 0] / widths[:, 1]
    assert (np.diff(ratio) > 0).all()
    assert_same(data, load(tmp_path / "cache", **options))
    for path in folder.glob("box?.ply"):
        path.unlink()
    with pytest.raises(ValueError, match="at least one usable model.*(broken|box1b)"):
        load(tmp_path / "other", **options)
    assert not any(path.is_dir() for path in (tmp_path / "other").iterdir())


def test_a_changed_file_or_material_is_rendered_anew_but_a_moved_folder_is_not(
    tmp_path,
):
    folder = write_boxes(tmp_path / "meshes", 1)
    options = dict(models=None, fractions=(1, 0, 0))
    cache = tmp_path / "cache"
    load(cache, folder=str(folder), **options)
    moved = tmp_path / "moved"
    folder.rename(moved)
    load(cache, folder=str(moved), **options)
    assert len(list(cache.glob("car-*"))) == 1
    (moved / "colours.mtl").write_text("newmtl red\nKd 1 0 0\n")
    load(cache, folder=str(moved), **options)
    assert len(list(cache.glob("car-*"))) == 2
    trimesh.creation.box(extents=[3, 1, 1]).export(moved / "box0.ply")
    load(cache, folder=str(moved), **options)
    assert len(list(cache.glob("car-*"))) == 3
