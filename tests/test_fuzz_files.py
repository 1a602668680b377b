"""Files that were cut, changed and grown are read, or refused in a sentence."""

import functools
import io
import json
import tempfile
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
import trimesh
from hypothesis import strategies
from PIL import Image

from dpc_jax.data import DataSpec, meshes, shards, views
from dpc_jax.data.sets import photographs, pose_files
from dpc_jax.shapes.normalization import normalize

# What is done to a file, in order: to the place, with some bytes.
EDITS = strategies.lists(
    strategies.tuples(
        strategies.sampled_from(["cut", "change", "change", "grow"]),
        strategies.integers(0, 1 << 16),
        strategies.binary(min_size=1, max_size=8),
    ),
    min_size=1,
    max_size=4,
)


def damage(content: bytes, edits) -> bytes:
    """A file after edits."""
    for kind, place, data in edits:
        place %= max(1, len(content))
        end = {"cut": len(content), "change": place + len(data), "grow": place}[kind]
        content = content[:place] + (b"" if kind == "cut" else data) + content[end:]
    return content


def _draw(mode="RGBA", side=12):
    pixels = np.random.default_rng(0).integers(0, 255, (side, side, 4), np.uint8)
    return Image.fromarray(pixels).convert(mode)


def _save_image(kind, mode="RGBA", **options):
    file = io.BytesIO()
    _draw(mode).save(file, kind, **options)
    return file.getvalue()


def _save_mesh(kind):
    mesh = trimesh.creation.box((1, 2, 3))
    mesh.visual.face_colors = np.full((12, 4), 90, np.uint8)  # pyright: ignore
    content: Any = mesh.export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


def _save_shard():
    arrays = {
        "masks": np.ones((2, 3, 3), np.uint8),
        "quaternions": np.ones((2, 4), np.float32),
        "surfaces": np.ones((5, 3), np.float32),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shard-00000.npz"
        counts = {name: [len(array)] for name, array in arrays.items()}
        shards.write_shard(path, arrays, {"names": ["a"], "counts": counts})
        return path.read_bytes()


OBJ = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl red\n"
OBJ += b"f 1/1 2/2 3/3\nv 0 0 1\nf -1/1 2/2 3/3\n"
MTL = b"newmtl red\nKd 1 0 0\nNs 3\nmap_Kd t.png\n"
LENS = {"fl_x": 100.0, "w": 80, "h": 80, "cx": 40}
FRAME = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
TRANSFORMS = json.dumps(LENS | {"frames": [FRAME, FRAME | {"file_path": "b"}]}).encode()


def _read_mesh(path):
    scene = views.build_scene(normalize(meshes.read_mesh(path)))
    lights = views.draw_lights(np.random.default_rng(0))
    views.render_view(scene, np.eye(3), lights=lights, image_size=4)


def _read_beside(path):
    """A mesh whose materials or texture are damaged."""
    obj = path.with_name("whole.obj")
    obj.write_bytes(OBJ)
    for name, content in (("a.mtl", MTL), ("t.png", _save_image("PNG"))):
        if path.name != name:
            path.with_name(name).write_bytes(content)
    _read_mesh(obj)


def _read_photograph(path):
    spec = DataSpec("car", kind="images", folder=".", image_size=8)
    photographs.read_photographs([path], spec)


def _read_shard(path):
    for array in shards.map_shard(path).arrays.values():
        array.sum()


def _read_poses(path):
    pose_files.read_poses([path])


FRAMES: dict[str, Any] = {"save_all": True, "append_images": [_draw("P")]}
GIF = functools.partial(_save_image, "GIF", "P", transparency=7, **FRAMES)
POSES = b'{"a.png": [1, 0, 0, 0], "b": [0, 1.5, 0, 0]}'
READERS = {  # name of a file: what makes it whole, what reads it
    "a.png": (functools.partial(_save_image, "PNG"), _read_photograph),
    "a.tif": (functools.partial(_save_image, "TIFF"), _read_photograph),
    "a.gif": (GIF, _read_photograph),
    "a.obj": (lambda: OBJ, _read_mesh),
    "a.ply": (functools.partial(_save_mesh, "ply"), _read_mesh),
    "a.stl": (functools.partial(_save_mesh, "stl"), _read_mesh),
    "a.off": (functools.partial(_save_mesh, "off"), _read_mesh),
    "a.glb": (functools.partial(_save_mesh, "glb"), _read_mesh),
    "a.mtl": (lambda: MTL, _read_beside),
    "t.png": (functools.partial(_save_image, "PNG"), _read_beside),
    "shard-00000.npz": (_save_shard, _read_shard),
    "poses.json": (lambda: POSES, _read_poses),
    "transforms.json": (lambda: TRANSFORMS, _read_poses),
}


@pytest.mark.filterwarnings("ignore")  # of libraries, on what is damaged
@pytest.mark.parametrize("tries", [40, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_in_a_sentence(name, tries, tmp_path):
    make, read = READERS[name]
    content, path = make(), tmp_path / name

    @hypothesis.settings(max_examples=tries, database=None)
    @hypothesis.given(EDITS)
    def try_once(edits):
        path.write_bytes(damage(content, edits))
        try:
            read(path)
        except (ValueError, OSError) as error:
            assert str(error).startswith("Expected") and str(error).endswith(".")

    path.write_bytes(content)
    read(path)  # whole, it is no error
    try_once()
