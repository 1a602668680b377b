"""What a careless or hostile user tries, and the sentence or result that comes of it.

A row is one try: what it is, a function that tries it in an empty folder, and words of
what it returns or refuses with.
"""

import contextlib
import functools
import os
import signal
import socket
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image

import dpc_jax
from dpc_jax import files
from dpc_jax.config import build_config, check, replace_fields
from dpc_jax.data import DataSpec, load_or_render, meshes, shards
from dpc_jax.data.sets import obj_materials, photographs, pose_files
from dpc_jax.data.sets.pictures import read_picture
from dpc_jax.run.workdir import hold_workdir
from dpc_jax.shapes.normalization import face_colors

SECONDS = 60  # after which a try hangs


class Try(NamedTuple):
    """One try. What it returns or refuses with has the words of `says`."""

    what: str
    attempt: Callable[[Path], Any]
    says: str


# Files: shards, records, meshes and their materials, images, locks, temporary files.

FACE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
RED = "newmtl red\nKd 1 0 0\n"


def _link(folder, name):
    """A user's file, and a link to it where a file of this package should be."""
    victim = folder / "victim.txt"
    victim.write_text("mine")
    (folder / name).symlink_to(victim)
    return victim


def hold_a_linked_lock(folder):
    victim = _link(folder, ".in-use")
    try:
        with hold_workdir(folder):
            pass
    finally:
        assert victim.read_text() == "mine"


def claim_a_linked_lock(folder):
    _link(folder, ".shard.claim")
    with files.claiming(folder / "shard"):
        pass


def write_beside_a_linked_temporary_file(folder):
    names = f".notes.{socket.gethostname()}.{os.getpid()}{files.TEMPORARY}"
    victim = _link(folder, names)
    files.write_text(folder / "notes", "new")
    return victim.read_text()


def map_a_shard(folder, *, read=shards.map_shard, save=np.savez, **members):
    """A stranger's shard. Of objects, it would supply the addresses of what is run."""
    record = np.frombuffer(b'{"names": ["a"]}', np.uint8)
    path = folder / "shard-00000.npz"
    save(path, **{"record": record} | members)
    if "masks" not in members:
        content = path.read_bytes().replace(b"'<f4'", b"'|O' ")
        path.write_bytes(content)
    return read(path)


POINTERS = {"quaternions": np.full((2, 4), 1e9, np.float32)}
FLAT = {"masks": np.zeros((2, 9), np.uint8)}
WIDE = {"masks": np.zeros((2, 3, 3), np.float64)}
PACKED = {"masks": np.zeros((2, 3, 3), np.uint8), "save": np.savez_compressed}


def look_at_a_mesh(folder, *, materials="a.mtl", texture=None, make=None):
    """Colour of a mesh, and what it lacks. `make` puts what hurts in a path's place."""
    place = folder / "above" / "here" / "a.obj"
    place.parent.mkdir(parents=True)
    place.write_text(f"mtllib {materials}\n{FACE}")
    hurt = place.parent / (texture or materials)
    if texture:
        place.with_suffix(".mtl").write_text(f"{RED}map_Kd {texture}\n")
    if make is not None:
        make(hurt)
    mesh = meshes.read_mesh(place)
    return f"{face_colors(mesh)[0, :3]} {obj_materials.describe_flaw(place)}"


def _put_beyond(path):
    """Materials at a place, and a link to them two folders above the mesh."""
    path.write_text(RED)


def _fill(path):
    path.touch()
    os.truncate(path, files.MOST_TEXT + 1)  # holes: it takes no room on the disk


GREY, PLAIN = "[170 170 170] lacks its materials", "[255   0   0] lacks 1 of 1 textures"


FRACTIONS = {"train": (1, 0, 0), "val": (8, 1, 1), "test": (0, 0, 1)}


def load_meshes(folder, *, good=3, split="test", **bad):
    """What a set makes of boxes and of other files; `bad` has their content."""
    (folder / "set").mkdir()
    for i in range(good):
        box = trimesh.creation.box((1, 2, 3 + i))
        box.export(folder / "set" / f"box{i}.ply")
    for name, text in bad.items():
        (folder / "set" / f"{name}.obj").write_text(text)
    spec = DataSpec(
        "car", folder=str(folder / "set"), split=split, views=2, image_size=16,
        fractions=FRACTIONS[split],
    )  # fmt: skip
    data = load_or_render(spec, cache_dir=folder / "cache", processes=1)
    return f"{len(data.names)} used, skipped {data.skipped}"


FAR = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1e30\nf 1 2 3\nf 2 3 4\n"


def read_an_image(folder, *, size=(8, 8), make=None, name="a.png"):
    path = folder / name
    if make is None:
        Image.new("1", size).save(path)
    else:
        make(path)
    return read_picture(path)


def read_large_frames(folder):
    frames = [Image.new("P", (3000, 2000), i) for i in range(3)]
    frames[0].save(folder / "a.gif", save_all=True, append_images=frames[1:])
    read = photographs._open_frames(folder / "a.gif")
    return [frame.size for frame in read]


def read_pose_file(folder, *, text, name="poses.json"):
    (folder / name).write_text(text)
    return pose_files.read_poses([folder / name])


@contextlib.contextmanager
def _losing_rights(folder):
    """A folder that anybody sees, and the rights of nobody in particular."""
    with tempfile.TemporaryDirectory(dir="/tmp") as shared:
        os.chmod(shared, 0o755)
        is_root = os.geteuid() == 0
        try:
            yield Path(shared), lambda: is_root and os.seteuid(65534)
        finally:
            if is_root:
                os.seteuid(0)


def load_meshes_without_rights(folder, *, closed):
    """Boxes, of which one or the cache is closed to the user."""
    with _losing_rights(folder) as (shared, lose):
        load_meshes(shared, good=2, split="test")
        if closed == "cache":
            box = trimesh.creation.box((2, 2, 5))
            box.export(shared / "set" / "more.ply")
        place = shared / closed
        os.chmod(place, 0o555 if place.is_dir() else 0)
        os.chmod(shared / "cache", 0o555 if closed == "cache" else 0o777)
        lose()
        spec = DataSpec(
            "car", folder=str(shared / "set"), split="test", views=2, image_size=16,
            fractions=(0, 0, 1),
        )  # fmt: skip
        data = load_or_render(spec, cache_dir=shared / "cache", processes=1)
        return f"{len(data.names)} used, skipped {data.skipped}"


def read_without_rights(folder, *, read, text="{}", name="poses.json"):
    with _losing_rights(folder) as (shared, lose):
        (shared / name).write_text(text)
        os.chmod(shared / name, 0)
        lose()
        return read(shared / name)


def _try(what, attempt, says, **options):
    return Try(what, functools.partial(attempt, **options), says)


LINKED = "there is a link to another file; remove the link"
DAMAGED = "as it was written, but it is damaged"
FILES = [
    _try("a workdir's lock that is a link", hold_a_linked_lock, LINKED),
    _try("a shard's lock that is a link", claim_a_linked_lock, LINKED),
    _try(
        "a link where a temporary file was foreseen",
        write_beside_a_linked_temporary_file,
        "mine",
    ),
    _try("a shard of objects, mapped", map_a_shard, DAMAGED, **POINTERS),
    _try(
        "a shard of objects, checked",
        map_a_shard,
        DAMAGED,
        read=shards.read_record,
        **POINTERS,
    ),
    _try("a shard with too few axes", map_a_shard, DAMAGED, **FLAT),
    _try("a shard of another type", map_a_shard, "masks is float64 (2, 3, 3)", **WIDE),
    _try("a compressed shard", map_a_shard, "does not lie in it as it is", **PACKED),
    _try("materials that are a pipe", look_at_a_mesh, GREY, make=os.mkfifo),
    _try(
        "a texture that is a pipe",
        look_at_a_mesh,
        PLAIN,
        texture="t.png",
        make=os.mkfifo,
    ),
    _try("materials without an end", look_at_a_mesh, GREY, materials="/dev/zero"),
    _try(
        "materials by a link without an end",
        look_at_a_mesh,
        GREY,
        make=lambda path: path.symlink_to("/dev/zero"),
    ),
    _try("huge materials", look_at_a_mesh, GREY, make=_fill),
    _try(
        "materials two folders above",
        look_at_a_mesh,
        GREY,
        materials="../../a.mtl",
        make=_put_beyond,
    ),
    _try(
        "materials one folder above",
        look_at_a_mesh,
        "[255   0   0] None",
        materials="../a.mtl",
        make=_put_beyond,
    ),
    _try(
        "materials by an absolute path", look_at_a_mesh, GREY, materials="/etc/passwd"
    ),
    _try(
        "a mesh with a coordinate far off",
        load_meshes,
        "3 used, skipped (('far.obj'",
        far=FAR,
    ),
    _try(
        "a mesh with a coordinate far off, in training",
        load_meshes,
        "skipped (('far.obj'",
        far=FAR,
        split="train",
    ),
    _try(
        "more bad meshes than good ones",
        load_meshes,
        "1 used, skipped ()",
        good=10,
        split="val",
        **{f"bad{i}": f"v {i} 0 0" for i in range(13)},
    ),
    _try(
        "a mesh whose name begins with a dash", load_meshes, "4 used", **{"-rf": FACE}
    ),
    _try(
        "a mesh that is a pipe",
        lambda folder: (
            os.mkfifo(folder / "a.ply") or meshes.read_mesh(folder / "a.ply")
        ),
        "a pipe, a device or the like",
    ),
    _try(
        "a huge image",
        read_an_image,
        "at most 67,108,864 pixels in the image",
        size=(12000, 12000),
    ),
    _try(
        "an image that is a pipe",
        read_an_image,
        "a pipe, a device or the like",
        make=os.mkfifo,
    ),
    _try(
        "an image whose name begins with a dash",
        read_an_image,
        "size=8x8",
        name="-a.png",
    ),
    _try(
        "a moving picture of large frames",
        read_large_frames,
        "[(1000, 667), (1000, 667), (1000, 667)]",
    ),
    _try(
        "poses in a list", read_pose_file, "it holds a list, not names", text="[1, 2]"
    ),
    _try(
        "poses of a number too large",
        read_pose_file,
        "cannot be read",
        text=f'{{"a": [1{"0" * 400}, 0, 0, 0]}}',
    ),
    _try(
        "poses nested too deep", read_pose_file, "nested too deep", text="[" * 100_000
    ),
    _try(
        "a mesh that the user may not read",
        load_meshes_without_rights,
        "box0.ply, but it cannot be read (Permission denied)",
        closed="set/box0.ply",
    ),
    _try(
        "a cache that the user may not write",
        load_meshes_without_rights,
        "set another data.cache_dir",
        closed="cache",
    ),
    _try(
        "an image that the user may not read",
        read_without_rights,
        "permission denied",
        read=read_picture,
    ),
    _try(
        "poses that the user may not read",
        read_without_rights,
        "Permission denied",
        read=lambda path: pose_files.read_poses([path]),
    ),
]

# Commands: what predict, fit, compare and main are given and told to write.

COMMANDS: list[Try] = []

# Calls of the public functions, and the fields of a config.

_CLOUD = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3)).astype("f4")
_IDENTITY, _MATRIX = np.array([1, 0, 0, 0], "f4"), np.eye(3, dtype="f4")
_MATRICES, _SINGULAR = np.tile(_MATRIX, (5, 1, 1)), np.ones((5, 3, 3), "f4")
_GRID = dpc_jax.VoxelGrid(4)


def _project(points=_CLOUD, rotation=_IDENTITY, *, function=dpc_jax.project, **changes):
    arguments = {"sigma": 1.0, "grid": _GRID} | changes
    image = function(points, rotation, **arguments).silhouette
    return "drawn" if np.isfinite(image).all() else "not finite"


def _give(says: str, name: str, value: Any, **others) -> list[Try]:
    """Tries of `project` with an argument, as it is and as an array of JAX."""

    def attempt(value):
        return _project(**{name: value} | others)

    return [
        Try(f"{name}: {says}", lambda _: attempt(value), says),
        Try(f"{name} of JAX: {says}", lambda _: attempt(jnp.asarray(value)), says),
    ]


def _batch(**changes):
    changes = {"rotation": np.tile(_IDENTITY, (2, 1))} | changes
    return _project(**changes, function=dpc_jax.project_batch)


def _project_volume(**changes):
    return dpc_jax.project_volume(np.ones((2, 2, 2), "f4"), grid=_GRID, **changes)


def _fit(**changes):
    return dpc_jax.fit(np.full((1, 64, 64), 255, "u1"), **changes)


def render_traced_numbers_by_the_documented_rule(_):
    """NaN points are left out, a zero quaternion is none, a negative sigma is 0."""

    def render(points, rotation, sigma):
        return dpc_jax.project(points, rotation, sigma=sigma, grid=_GRID).silhouette

    spoiled = np.concatenate([_CLOUD, np.full((1, 3), np.nan, "f4")])
    image = jax.jit(render)(spoiled, 0 * _IDENTITY, -1.0)
    return np.allclose(image, render(_CLOUD, _IDENTITY, 0.0))


def _check(section, **fields):
    check(replace_fields(build_config("car"), {section: fields}))
    return "works"


CALLS = [
    *_give("rotation must be finite", "rotation", _IDENTITY * np.nan),
    *_give("finite and not zero", "rotation", 0 * _IDENTITY),
    *_give("and determinant 1, but it is [[2.0", "rotation", 2 * _MATRIX),
    *_give("and determinant 1, but it is [[-1.0", "rotation", -_MATRIX),
    *_give("and determinant 1, but it is [[nan", "rotation", _MATRIX * np.nan),
    *_give("points must be finite", "points", _CLOUD * np.inf),
    *_give("translation must be finite", "translation", np.array([0, 0, np.nan])),
    *_give("sigma must be at least 0 voxels and finite, but it is -1.0", "sigma", -1.0),
    *_give(
        "sigma must be at least 0 voxels and finite, but it is nan", "sigma", np.nan
    ),
    *_give("one is -1.0", "sigma", np.array([1, 1, -1, 1, 1], "f4")),
    *_give("scale must be at least 0 voxels and finite, but it is -1.0", "scale", -1.0),
    *_give("but one is inf", "scale", np.full(5, np.inf, "f4")),
    *_give("without negative eigenvalues", "covariance", -_MATRICES, sigma=None),
    *_give("without negative", "covariance", _MATRICES - _SINGULAR, sigma=None),
    *_give("drawn", "covariance", _SINGULAR, sigma=None),
    Try(
        "a camera that mirrors",
        lambda _: _project(camera=dpc_jax.Camera(-1.0)),
        "camera.focal_length must be finite and above 0, but it is -1.0",
    ),
    Try(
        "a camera of an array of zero",
        lambda _: _project(camera=dpc_jax.Camera(jnp.array(0.0))),
        "camera.focal_length must be finite and above 0, but it is 0.0",
    ),
    Try(
        "a camera that is infinitely far",
        lambda _: _project(camera=dpc_jax.Camera(1.0, np.inf)),
        "camera.distance must be finite",
    ),
    Try(
        "a grid of 100,000 voxels a side",
        lambda _: _project(grid=dpc_jax.VoxelGrid(100_000)),
        "a volume of [100000, 100000, 100000] takes 4e+06 GB; make it coarser",
    ),
    Try(
        "one pose of a batch is zero",
        lambda _: _batch(rotation=np.stack([_IDENTITY, 0 * _IDENTITY])),
        "rotations must be finite and not zero, but one is [0.0, 0.0, 0.0, 0.0]",
    ),
    Try("a batch and -σ", lambda _: _batch(sigma=-1.0), "sigma must be at least 0"),
    Try(
        "a batch of cameras",
        lambda _: _batch(camera=dpc_jax.Camera(np.array([1.0, -1.0], "f4"))),
        "camera.focal_length must be finite and above 0, but one is -1.0",
    ),
    Try(
        "a volume that is mirrored",
        lambda _: _project_volume(rotation=-_MATRIX),
        "rotation must be a rotation",
    ),
    Try(
        "a fit from a pose of zeros",
        lambda _: _fit(rotations=np.zeros((1, 4), "f4")),
        "rotations must be finite and not zero",
    ),
    Try(
        "a fit by a camera that mirrors",
        lambda _: _fit(camera=dpc_jax.Camera(-1.0)),
        "camera.focal_length must be finite and above 0",
    ),
    Try("traced numbers", render_traced_numbers_by_the_documented_rule, "True"),
    Try(
        "more steps than can be counted",
        lambda _: _check("train", steps=10**20),
        "config.train.steps must be at most 2,147,483,647",
    ),
    Try("one step", lambda _: _check("train", steps=1), "works"),
    Try(
        "a folder's name that no file system takes",
        lambda _: _check("data", meshes="m" * 300),
        "a folder that exists",
    ),
]


def _hang(*_):
    pytest.fail(f"still at work after {SECONDS} s")


@pytest.mark.parametrize(
    "attempt, says",
    [pytest.param(*row[1:], id=row.what) for row in (*FILES, *COMMANDS, *CALLS)],
)
def test_a_try_ends_in_a_result_or_in_a_sentence(attempt, says, tmp_path):
    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(SECONDS)
    try:
        said = str(attempt(tmp_path))
    except (ValueError, OSError) as error:
        said = str(error)
        assert said.endswith(".")
    finally:
        signal.alarm(0)
    assert says in said
