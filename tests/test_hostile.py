"""What a careless or hostile user tries, and the sentence or result that comes of it.

A row is one try: what it is, a function that tries it in an empty folder, and words of
what it returns or refuses with.
"""

import contextlib
import dataclasses
import functools
import io
import os
import signal
import socket
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image
from tiny_runs import tiny_config

import dpc_jax
import dpc_jax.fit as fit
from dpc_jax import compare, files, outputs, paper, predict
from dpc_jax.config import build_config, check, replace_fields, to_json
from dpc_jax.data import DataSpec, load_or_render, meshes, shards
from dpc_jax.data import __main__ as data_command
from dpc_jax.data.sets import masks, mesh_folder, photographs, pictures, pose_files
from dpc_jax.data.sets.photographs import Request, read_photographs
from dpc_jax.data.sets.pictures import read_picture
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.outputs import show_text
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.run import prediction
from dpc_jax.run.prediction import objects as predicted_objects
from dpc_jax.run.workdir import (
    claim_workdir,
    hold_workdir,
    read_alignment,
    read_config,
)
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


def hold_a_lock_with_two_names(folder):
    victim = folder / "victim.txt"
    victim.write_text("mine")
    os.link(victim, folder / ".in-use")
    try:
        with hold_workdir(folder):
            pass
    finally:
        assert victim.read_text() == "mine"


def hold_a_lock_of_another_kind(folder, *, make):
    make(folder / ".in-use")
    with hold_workdir(folder):
        pass


def record_in_a_linked_file(folder):
    _link(folder, "metrics.jsonl")
    MetricLog(folder / "metrics.jsonl").write({"step": 1})


def read_records(folder, *, make):
    make(folder / "metrics.jsonl")
    return MetricLog(folder / "metrics.jsonl").read()


def read_deep_config(folder):
    (folder / "config.json").write_text("[" * 100_000)
    read_config(folder)


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
    return f"{face_colors(mesh)[0, :3]} {mesh_folder.describe_flaw(place)}"


def _put_beyond(path):
    """Materials at a place, and a link to them two folders above the mesh."""
    path.write_text(RED)


def _fill(path):
    path.touch()
    os.truncate(path, files.MOST_TEXT + 1)  # holes: it takes no room on the disk


GREY, PLAIN = "[170 170 170] lacks its materials", "[255   0   0] lacks 1 of 1 textures"


FRACTIONS = {"train": (1, 0, 0), "val": (8, 1, 1), "test": (0, 0, 1)}


def load_meshes(folder, *, good=3, split="test", models=None, **bad):
    """What a set makes of boxes and of other files; `bad` has their content."""
    (folder / "set").mkdir()
    for i in range(good):
        box = trimesh.creation.box((1, 2, 3 + i))
        box.export(folder / "set" / f"box{i}.ply")
    for name, text in bad.items():
        (folder / "set" / f"{name}.obj").write_text(text)
    spec = DataSpec(
        "car", folder=str(folder / "set"), split=split, views=2, image_size=16,
        fractions=FRACTIONS[split], models=models,
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
    read = pictures.read_frames(folder / "a.gif", photographs.MOST_FRAMES)
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
    _try(
        "a workdir's lock that has another name, too",
        hold_a_lock_with_two_names,
        "a hard link; remove the link",
    ),
    _try(
        "a workdir's lock that is a pipe",
        hold_a_lock_of_another_kind,
        "a pipe or the like; remove it",
        make=os.mkfifo,
    ),
    _try(
        "a workdir's lock that is a folder",
        hold_a_lock_of_another_kind,
        "a pipe or the like; remove it",
        make=os.mkdir,
    ),
    _try("a shard's lock that is a link", claim_a_linked_lock, LINKED),
    _try(
        "a run's records that are a pipe",
        read_records,
        "a pipe, a device or the like",
        make=os.mkfifo,
    ),
    _try(
        "a run's records that are nested too deep",
        read_records,
        "[]",
        make=lambda path: path.write_text("[" * 100_000),
    ),
    _try(
        "lines of a run's records that are none",
        read_records,
        "[{'step': 1}]",
        make=lambda path: path.write_bytes(b'5\n"x"\n{"step": "z"}\n\xff\n{"step": 1}'),
    ),
    _try("a config that is nested too deep", read_deep_config, "nested too deep"),
    _try("a run's records that are a link", record_in_a_linked_file, LINKED),
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
        "bad meshes that come before the good ones, of which a few are wanted",
        load_meshes,
        "3 used, skipped ()",
        good=10,
        split="train",
        models=3,
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


def draw_image(path, *, alpha=255):
    """A disc of some opacity on nothing; the path."""
    rows, cols = np.mgrid[:40, :40]
    mask = ((rows - 20) ** 2 + (cols - 17) ** 2 < 80).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(np.dstack([90 * mask] * 3 + [alpha * mask]))
    image.save(path, format="GIF" if path.suffix == ".gif" else "PNG")
    return path


def read_all(folder):
    """Content of every file below a folder, but the list of what commands wrote."""
    return {
        path: path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
        and path.name != outputs.LIST
        and os.access(path, os.R_OK, effective_ids=True)
    }


def call(command, *words):
    """What a command says when it is refused: one line, and no file is changed."""
    folders = [Path(word).parent for word in map(str, words) if word.startswith("/")]
    before = [read_all(folder) for folder in folders]
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        status = command.main(list(map(str, words)))
    line = said.getvalue()
    assert line.startswith("Error: ") and line.count("\n") == 1 and line.isascii()
    assert before == [read_all(folder) for folder in folders]
    return f"{line[7:-1]} Status {status}."


def make_workdir(folder, **changes):
    """The folder of a run as far as it is read before a network is."""
    workdir = folder / "run"
    workdir.mkdir()
    (workdir / "config.json").write_text(to_json(tiny_config(**changes)))
    return workdir


def predicts(*names, flags=(), out="out", draw=()):
    """A call of predict with images of these names, and others in the folder."""

    def attempt(folder):
        words = [f"--workdir={make_workdir(folder)}", f"--out={folder / out}", *flags]
        for name in {*names, *draw}:
            draw_image(folder / name)
        return call(predict, *words, *(folder / name for name in names))

    return attempt


def predict_again_over_what_was_changed(folder):
    """The first call writes, then a user edits a file of it, and it comes again."""
    names = ["a.ply", "predictions.json"]
    with outputs.owning(folder, names):
        for name in names:
            (folder / name).write_text("written")
    with outputs.owning(folder, names):  # its own files are no obstacle
        (folder / "a.ply").write_text("written anew")
    (folder / "a.ply").write_text("edited")
    with outputs.owning(folder, names):
        return "overwritten"


def write_after_a_kill(folder):
    """What a killed command wrote is still known as its own."""
    root = str(Path(outputs.__file__).parents[1])
    code = "import os, sys, pathlib\nfrom dpc_jax import outputs\n"
    code += "with outputs.owning(sys.argv[1], ['a.ply']):\n"
    code += "    pathlib.Path(sys.argv[1], 'a.ply').write_text('half')\n    os._exit(9)"
    killed = subprocess.run([sys.executable, "-c", code, str(folder)], cwd=root)
    assert killed.returncode == 9
    with outputs.owning(folder, ["a.ply"]):
        return (folder / "a.ply").read_text()


def show_over_a_photograph(folder):
    draw_image(folder / "set" / "one" / "0.png")
    photograph = draw_image(folder / "photograph.png")
    return call(data_command, "show", folder / "set", f"--out={photograph}")


def fit_into_the_folder_of_its_views(folder):
    for name in ("0.png", "views.png"):
        draw_image(folder / name)
    return call(fit, folder, f"--out={folder}")


def compare_over_a_page(folder):
    make_workdir(folder)
    (folder / "index.html").write_text("mine")
    return call(compare, folder / "run", f"--out={folder}")


def publish_over_another_page(folder):
    (folder / "notes.md").write_text("# Mine\n")
    page = f"--page={folder / 'notes.md'}"
    return call(paper, f"--out={folder / 'out'}", "--no-training", page)


def train_in_a_folder_with_a_config_of_another_program(folder):
    (folder / "config.json").write_text('{"editor": "mine"}')
    try:
        claim_workdir(folder, tiny_config())
    finally:
        assert (folder / "config.json").read_text() == '{"editor": "mine"}'


def write_into(*parts, user=None):
    """Predictions into a place that cannot be written."""

    def attempt(folder):
        image = draw_image(folder / "a.png")
        out = Path(*parts) if parts[0] == "/" else folder.joinpath(*parts)
        words = f"--workdir={make_workdir(folder)}", f"--out={out}", image
        return call(predict, *words)

    return attempt


def without_rights(prepare):
    """A call of predict by somebody with no rights but everybody's.

    Args:
      prepare: makes the words from a folder that everybody may enter.
    """

    def attempt(_):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            folder.chmod(0o755)
            words = prepare(folder)
            call(predict, "--workdir=/nowhere", draw_image(folder / "b.png"))
            is_root = os.geteuid() == 0
            if is_root:  # who may do everything
                os.seteuid(65534)
            try:
                return call(predict, *words)
            finally:
                if is_root:
                    os.seteuid(0)

    return attempt


def write_in_a_folder_of_others(folder):
    workdir = make_workdir(folder)
    workdir.chmod(0o555)
    return f"--workdir={workdir}", draw_image(folder / "a.png")


def read_an_image_of_others(folder):
    draw_image(folder / "a.png").chmod(0)
    out = folder / "out"
    out.mkdir()
    out.chmod(0o777)
    return f"--workdir={make_workdir(folder)}", f"--out={out}", folder / "a.png"


def name_a_file_like_a_flag(folder):
    draw_image(folder / "-a.png")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", ["predict", "--workdir=run", "-a.png"])
        return call(predict, *sys.argv[1:])


def name_files_in_bytes_of_all_kinds(folder):
    """Bytes that are no UTF-8, line breaks, codes of terminals, formulas, 車."""
    names = [
        b"a\xff",
        b"a\nb",
        b"\x1b[31ma",
        b"a\xe2\x80\xaeb",
        b"$\\frac$",
        b"\xe8\xbb\x8a",
    ]
    paths = [draw_image(folder / os.fsdecode(name + b".png")) for name in names]
    spec = DataSpec("car", kind="images", folder=".", image_size=16, crop="object")
    found, _ = read_photographs(Request([folder]), spec)
    (one,) = found
    shown = [*one.sources, *(show_text(path) for path in paths)]
    text = "".join(shown)
    assert text.isprintable() and text.encode()
    blank = np.zeros((4, 4))
    row = Example("", blank, blank, blank, np.zeros((1, 3)), None, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in shown:
            draw_predictions([dataclasses.replace(row, name=name)], folder / "a.png")
    return Path(shown[-1]).name


def show_a_set_with_a_name_that_is_no_text(folder):
    for name in (b"a\xff", b"b", b"c\nd"):
        draw_image(folder / "set" / os.fsdecode(name) / "0.png")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        words = ["show", str(folder / "set"), f"--out={folder / 'sheet.png'}"]
        assert data_command.main(words) == 0
    return said.getvalue()


def keep_codes(content):
    """Refinement with kept directions of this content, where measuring gives ones."""

    def attempt(folder):
        whole = np.zeros((2, 5), np.float32).tobytes()
        (folder / "codes-3.f32").write_bytes(content(whole))
        ones = np.ones((2, 5), np.float32)
        read = predicted_objects.read_directions
        read(folder, 3, 5, lambda: ones)
        return read(folder, 3, 5, list).sum()  # what is measured is kept

    return attempt


def refine_with_a_cache_folder_of_others(folder):
    """Where data are kept for a workdir whose config says elsewhere."""
    config = replace_fields(tiny_config(), {"data": {"cache_dir": "/elsewhere"}})
    places = []

    def stop(config):
        places.append(config.data.cache_dir)
        raise ValueError("Enough.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predicted_objects, "read_config", lambda _: config)
        patch.setattr(predicted_objects, "make_network", stop)
        for data in (None, Path("/asked")):
            with contextlib.suppress(ValueError):
                request = prediction.PredictRequest([], folder, folder, data=data)
                predicted_objects.predict_objects([], request)
    return [place.replace(str(folder), "RUN") for place in places]


def ask_for_more_points_than_there_are(_):
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        cloud: Any = SimpleNamespace(points=np.zeros((1200, 3)))
        prediction.warn_of_few_points([cloud], 10**8)
    return said.getvalue()


def find_mask(image):
    return lambda _: masks.find_before_plain_background(np.asarray(image, np.uint8))


def draw_spots():
    """Many blobs of one size, as a texture has them."""
    image = np.full((96, 96, 3), 220)
    for row in range(10, 90, 20):
        for column in range(10, 90, 20):
            image[row : row + 9, column : column + 9] = (90, 60, 20)
    return image


def draw_cross():
    image = np.full((96, 96, 3), 220)
    image[44:52], image[:, 44:52] = (20, 90, 20), (20, 90, 20)
    return image


def draw_tiles():
    tiles = np.random.default_rng(0).integers(0, 255, (8, 8, 3))
    return tiles.repeat(12, 0).repeat(12, 1)


def fit_views(**images):
    """A fit of a folder of images, as functions that draw them."""

    def attempt(folder):
        for name, draw in images.items():
            draw(folder / "views" / f"{name}.png")
        return call(fit, folder / "views", f"--out={folder / 'out'}")

    return attempt


def draw_without_alpha(path):
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (20, 20), "red").save(path)


def read_wrong_alignment(text):
    def attempt(folder):
        (folder / "report").mkdir()
        (folder / "report" / "alignment.json").write_text(text)
        return read_alignment(folder)

    return attempt


def name_no_file(folder, *, command, words):
    make_workdir(folder)
    with contextlib.chdir(folder):
        return call(command, *words, "x" * 300)


def predict_a_device(folder):
    return call(predict, f"--workdir={make_workdir(folder)}", "/dev/null")


NOT_OURS = "what is there was not written by a command; move it, or give another --out"
COMMANDS = [
    Try(
        "predict --turntable where the picture is in the folder of results",
        predicts("out/anim.gif", flags=["--turntable"]),
        "out/anim.gif, but it is an input; move it, or give another --out.",
    ),
    Try(
        "predict into a folder that has a file of the user's under an output's name",
        predicts("a.png", draw=["out/a.json"]),
        f"out/a.json, but {NOT_OURS}.",
    ),
    Try(
        "predict of predictions.png, whose file would be the summary's",
        predicts("predictions.png"),
        "out/predictions.json would be written twice; rename the input, or",
    ),
    Try(
        "predict of two images of one name",
        predicts("a.png", "b/a.png"),
        "different names, but a came more than once; predict them one by one",
    ),
    Try(
        "an output that a user has changed",
        predict_again_over_what_was_changed,
        "has been changed since a command wrote it; move it",
    ),
    Try("an output of a command that was killed", write_after_a_kill, "half"),
    Try("data show over a photograph", show_over_a_photograph, NOT_OURS),
    Try(
        "fit into the folder of its views, one of which is called views.png",
        fit_into_the_folder_of_its_views,
        "views.png, but it is an input",
    ),
    Try("compare over a page of the user's", compare_over_a_page, NOT_OURS),
    Try(
        "the paper's experiments published over another page",
        publish_over_another_page,
        "does not begin with # The paper's experiments; move it",
    ),
    Try(
        "a run in a folder that has a config.json of another program",
        train_in_a_folder_with_a_config_of_another_program,
        "but it cannot be used (config must have no other fields",
    ),
    Try("--out=FILE", write_into("a.png"), "made or written (it is a file); give"),
    Try(
        "--out below a file",
        write_into("a.png", "x"),
        "made or written (Not a directory)",
    ),
    Try("--out=/proc/x", write_into("/", "proc", "x"), "made or written (No such file"),
    Try(
        "--out of 300 letters",
        write_into("x" * 300),
        "made or written (File name too long)",
    ),
    *(
        Try(
            f"a path that no file system takes, of {command.__name__}",
            functools.partial(name_no_file, command=command, words=words),
            "cannot be read or written (File name too long); make room, or give",
        )
        for command, words in (
            (fit, []),
            (predict, ["--workdir=run"]),
            (paper, ["--no-training", "--page"]),
        )
    ),
    Try(
        "predict of an image with a name of 251 letters",
        predicts("x" * 251 + ".png"),
        "there can be no such file (File name too long); rename the input",
    ),
    Try(
        "predict into a workdir that may only be read",
        without_rights(write_in_a_folder_of_others),
        "run/predictions, but it cannot be made or written (Permission denied); give",
    ),
    Try(
        "predict of an image that may not be read",
        without_rights(read_an_image_of_others),
        "a.png, but it is damaged or of another kind (permission denied",
    ),
    Try(
        "predict of a file whose name begins with -",
        name_a_file_like_a_flag,
        "write ./-a.png for the file whose name begins with -. Status 2.",
    ),
    Try("names of files in bytes of all kinds", name_files_in_bytes_of_all_kinds, "車"),
    Try(
        "data show of objects whose names are no text",
        show_a_set_with_a_name_that_is_no_text,
        "3 object models",
    ),
    Try("refinement with cut directions of codes", keep_codes(lambda c: c[:-9]), "10"),
    Try("refinement with empty directions of codes", keep_codes(lambda c: b""), "10"),
    Try("refinement with whole directions of codes", keep_codes(lambda c: c), "0.0"),
    Try(
        "refinement with a workdir whose config names a folder for data",
        refine_with_a_cache_folder_of_others,
        "['RUN/data', '/asked']",
    ),
    Try(
        "more points than midpoints give",
        ask_for_more_points_than_there_are,
        "--points=100000000 is more than midpoints of neighbours give: a cloud here "
        "has 1,200 points",
    ),
    Try("a mask of a busy image", find_mask(draw_tiles()), "several colours"),
    Try("a mask of nothing", find_mask(np.full((64, 64, 3), 180)), "nothing differs"),
    Try("a mask of a texture", find_mask(draw_spots()), "the largest of which is"),
    Try("a mask of what is cut off", find_mask(draw_cross()), "of the image's border"),
    Try(
        "fit of a view whose alpha channel is faint",
        fit_views(a=lambda path: draw_image(path, alpha=100)),
        "a.png, but it is nowhere more than 39 % opaque, and what is half opaque",
    ),
    Try(
        "fit of a view without a mask, which --mask=auto is no answer to",
        fit_views(a=draw_without_alpha),
        "a_mask.png beside it, but found neither; add a mask. Status 1.",
    ),
    Try(
        "an alignment of zeros",
        read_wrong_alignment('{"rotation": [0, 0, 0, 0]}'),
        "[0.0, 0.0, 0.0, 0.0] is no unit quaternion",
    ),
    Try("an alignment that is a list", read_wrong_alignment("[1]"), "Expected a rot"),
    Try("predict of /dev/null", predict_a_device, "/dev/null is no regular file"),
]

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


def _differentiate(transform: Callable, function=dpc_jax.project):
    """The derivative of a silhouette by its pose, or the refusal of one."""

    def render(rotation):
        return function(_CLOUD, rotation, sigma=1.0, grid=_GRID).silhouette

    rotation = jnp.asarray(_IDENTITY)
    try:
        transform(render)(rotation if function is dpc_jax.project else rotation[None])
    except TypeError as error:
        return error
    return "differentiated"


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
    *_give("scale must be at least 0 voxels and finite", "scale", 1e308),
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
        "forward mode",
        lambda _: _differentiate(jax.jacfwd),
        "but forward mode came (jax.jvp, jax.jacfwd, jax.hessian); take jax.jacrev",
    ),
    Try(
        "a Hessian under jit",
        lambda _: _differentiate(lambda f: jax.jit(jax.hessian(f))),
        "take jax.jacrev twice for second derivatives",
    ),
    Try(
        "forward mode of a batch",
        lambda _: _differentiate(jax.jacfwd, dpc_jax.project_batch),
        "but forward mode came",
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
