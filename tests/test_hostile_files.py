"""Files of a stranger: shards, records, meshes, images, poses."""

import os

import numpy as np
import pytest
import trimesh
from hostile import Table, assert_try_says, losing_rights
from PIL import Image

from dpc_jax import files
from dpc_jax.data import DataSpec, load_or_render, meshes, shards
from dpc_jax.data.sets import photographs, pictures
from dpc_jax.data.sets.pictures import read_picture
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.run.workdir import read_alignment, read_config
from dpc_jax.shapes.normalization import face_colors

TABLE = Table()
tries = TABLE.tries

FACE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
RED = "newmtl red\nKd 1 0 0\n"
DEEP = "[" * 100_000


@tries("a pipe, a device or the like", content=None)
@tries("[]", content=DEEP.encode())
@tries("[{'step': 1}]", content=b'5\n"x"\n{"step": "z"}\n\xff\n{"step": 1}')
def read_records(folder, *, content):
    path = folder / "metrics.jsonl"
    os.mkfifo(path) if content is None else path.write_bytes(content)
    return MetricLog(path).read()


@tries("nested too deep")
def read_a_deep_config(folder):
    (folder / "config.json").write_text(DEEP)
    read_config(folder)


@tries("[0.0, 0.0, 0.0, 0.0] is no unit quaternion", text='{"rotation": [0, 0, 0, 0]}')
@tries("Expected the alignment", text="[1]")
def read_a_wrong_alignment(folder, *, text):
    (folder / "report").mkdir()
    (folder / "report" / "alignment.json").write_text(text)
    return read_alignment(folder)


POINTERS = np.full((2, 4), 1e9, np.float32)
PACKED = {"masks": np.zeros((2, 3, 3), np.uint8), "save": np.savez_compressed}
DAMAGED = "a shard as it was written in"


@tries(DAMAGED, quaternions=POINTERS)
@tries(DAMAGED, masks=np.zeros((2, 9), np.uint8))
@tries("masks is float64 (2, 3, 3)", masks=np.zeros((2, 3, 3), np.float64))
@tries("does not lie in it as it is", **PACKED)
def read_a_shard(folder, *, save=np.savez, **members):
    """A stranger's shard. Of objects, it would supply the addresses of what is run."""
    record = np.frombuffer(b'{"names": ["a"]}', np.uint8)
    path = folder / "shard-00000.npz"
    save(path, **{"record": record} | members)
    if "masks" not in members:
        path.write_bytes(path.read_bytes().replace(b"'<f4'", b"'|O' "))
    return shards.map_shard(path)


def _write_red(path):
    path.write_text(RED)


def _link_to_zeros(path):
    path.symlink_to("/dev/zero")


def _fill(path):
    path.touch()
    os.truncate(path, files.MOST_TEXT + 1)  # holes: it takes no room on the disk


GREY, PLAIN = "[170 170 170] lacks ", "[255   0   0] lacks t.png"


@tries(GREY, make=os.mkfifo)
@tries(PLAIN, texture="t.png", make=os.mkfifo)
@tries(GREY, materials="/dev/zero")
@tries(GREY, make=_link_to_zeros)
@tries(GREY, make=_fill)
@tries(GREY, materials="../../a.mtl", make=_write_red)
@tries("[255   0   0] whole", materials="../a.mtl", make=_write_red)
def look_at_a_mesh(folder, *, materials="a.mtl", texture=None, make=None):
    """Colour of a mesh, and what it lacks. `make` puts what hurts in a path's place."""
    place = folder / "above" / "here" / "a.obj"
    place.parent.mkdir(parents=True)
    place.write_text(f"mtllib {materials}\n{FACE}")
    if texture:
        place.with_suffix(".mtl").write_text(f"{RED}map_Kd {texture}\n")
    if make is not None:
        make(place.parent / (texture or materials))
    mesh = meshes.read_mesh(place)
    return f"{face_colors(mesh)[0, :3]} {mesh.metadata['flaw'] or 'whole'}"


FRACTIONS = {"train": (1, 0, 0), "test": (0, 0, 1)}
FAR = {"far": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1e30\nf 1 2 3\nf 2 3 4\n"}


@tries("3 used, skipped (('far.obj'", bad=FAR)
@tries("skipped (('far.obj'", bad=FAR, split="train")
@tries("4 used", bad={"-rf": FACE})
@tries("set another data.cache_dir", make=os.mkfifo)
def load_meshes(folder, *, bad=(), split="test", make=os.mkdir):
    """What a set makes of boxes and of other files."""
    (folder / "set").mkdir()
    make(folder / "cache")
    for i in range(3):
        box = trimesh.creation.box((1, 2, 3 + i))
        box.export(folder / "set" / f"box{i}.ply")
    for name, text in dict(bad).items():
        (folder / "set" / f"{name}.obj").write_text(text)
    return _load(folder, split=split, fractions=FRACTIONS[split])


def _load(folder, **options):
    spec = DataSpec(
        "car", folder=str(folder / "set"), views=2, image_size=16, **options
    )
    data = load_or_render(spec, cache_dir=folder / "cache", processes=1)
    return f"{len(data.names)} used, skipped {data.skipped}"


@tries("box0.ply, but it cannot be read (Permission denied)")
def load_a_mesh_without_rights(_):
    with losing_rights() as (shared, lose):
        load_meshes(shared)
        (shared / "set" / "box0.ply").chmod(0)
        box = trimesh.creation.box((2, 2, 5))
        box.export(shared / "set" / "more.ply")  # so that all is read again
        (shared / "cache").chmod(0o777)
        lose()
        return _load(shared, split="test", fractions=FRACTIONS["test"])


@tries("a pipe, a device or the like")
def read_a_mesh_that_is_a_pipe(folder):
    os.mkfifo(folder / "a.ply")
    return meshes.read_mesh(folder / "a.ply")


@tries("at most 67,108,864 pixels in the image", size=(12000, 12000))
@tries("a pipe, a device or the like", make=os.mkfifo)
@tries("size=8x8", name="-a.png")
def read_an_image(folder, *, size=(8, 8), make=None, name="a.png"):
    path = folder / name
    Image.new("1", size).save(path) if make is None else make(path)
    return read_picture(path)


@tries("[(1000, 667), (1000, 667), (1000, 667)]")
def read_large_frames(folder):
    frames = [Image.new("P", (3000, 2000), i) for i in range(3)]
    frames[0].save(folder / "a.gif", save_all=True, append_images=frames[1:])
    read = pictures.read_frames(folder / "a.gif", photographs.MOST_FRAMES)
    return [frame.size for frame in read]


@pytest.mark.parametrize("attempt, says", TABLE)
def test_a_file_is_read_or_refused_in_a_sentence(attempt, says, tmp_path):
    assert_try_says(attempt, says, tmp_path)
