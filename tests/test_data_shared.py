"""One set, several processes that know nothing of each other, one shared folder."""

import collections
import subprocess
import sys

import pytest

from dpc_jax.data import DataSpec, load_or_render
from dpc_jax.data.dataset import read_cache

MODELS = 40  # in ten shards
SPEC = dict(
    category="car", models=MODELS, views=1, image_size=16,
    surface_points=20,
)  # fmt: skip

# Renders the set once a line comes; notes each shard in a file when it is on disk. With
# a third argument it stops for ever in the middle of its second shard.
RENDER = f"""
import sys, time
from dpc_jax.data import DataSpec, load_or_render, shards
from dpc_jax.data.sets import mesh_folder
cache, notes, *stuck = sys.argv[1:]
write, make = shards.write_shard, mesh_folder.ProceduralShapes.make_arrays
made = 0

def write_and_note(path, *arrays):
    write(path, *arrays)
    with open(notes, "a") as file:
        file.write(path.name + "\\n")

def make_slowly(self, model, index):
    global made
    made += 1
    if stuck and made == 6:
        print("stuck", flush=True)
        time.sleep(600)
    time.sleep(0.02)
    return make(self, model, index)

shards.write_shard = write_and_note
mesh_folder.ProceduralShapes.make_arrays = make_slowly
print("ready", flush=True)
sys.stdin.readline()
load_or_render(DataSpec(**{SPEC}), cache_dir=cache, processes=1)
print("whole", flush=True)
"""


def read(process):
    """The next word, between lines of progress."""
    lines = iter(process.stdout.readline, "")
    return next(line.strip() for line in lines if " " not in line)


def count(folder):
    """How often each shard was written, by each process."""
    paths = sorted(folder.glob("notes-*"))
    return [collections.Counter(path.read_text().split()) for path in paths]


@pytest.fixture
def start(tmp_path):
    """Starts processes that share a folder; whatever happens, they end."""
    started = []

    def start(*stuck):
        notes = tmp_path / f"notes-{len(started)}"
        notes.touch()
        words = sys.executable, "-c", RENDER, tmp_path / "shared", notes, *stuck
        options = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(subprocess.Popen(words, **options))
        assert read(started[-1]) == "ready"
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def begin(process):
    process.stdin.write("\n")
    process.stdin.flush()


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The set as one process makes it."""
    cache = tmp_path_factory.mktemp("alone")
    load_or_render(DataSpec(**SPEC), cache_dir=cache, processes=1)
    (folder,) = cache.iterdir()
    return folder


def assert_like_alone(cache, alone):
    (folder,) = cache.iterdir()
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        p.name for p in alone.iterdir()
    )
    for path in alone.iterdir():
        assert (folder / path.name).read_bytes() == path.read_bytes(), path.name
    assert len(read_cache(folder).names) == MODELS


def test_the_shard_of_a_killed_process_is_taken_over(start, alone, tmp_path):
    killed, other = start("stuck"), start()
    begin(killed)
    assert read(killed) == "stuck"
    begin(other)
    while sum(count(tmp_path)[1].values()) < 8:  # all but what the first has and had
        assert other.poll() is None
    killed.kill()
    assert read(other) == "whole"
    assert [sum(notes.values()) for notes in count(tmp_path)] == [1, 9]
    assert_like_alone(tmp_path / "shared", alone)


def test_where_the_disk_knows_no_locks_everything_is_still_made(
    tmp_path, monkeypatch, alone
):
    def refuse(*_):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("fcntl.flock", refuse)
    load_or_render(DataSpec(**SPEC), cache_dir=tmp_path, processes=1)
    assert_like_alone(tmp_path, alone)
