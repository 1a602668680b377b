"""Commands: what predict, fit, compare and main are given and told to write."""

import contextlib
import dataclasses
import functools
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from data_trees import save_disc
from hostile import Table, assert_try_says
from PIL import Image
from tiny_runs import tiny_config, write_workdir

import dpc_jax.fit as fit
from dpc_jax import benchmark, compare, outputs, paper, predict, stability, view
from dpc_jax.data import DataSpec
from dpc_jax.data import __main__ as data_command
from dpc_jax.data.sets import masks
from dpc_jax.data.sets.photographs import read_photographs
from dpc_jax.outputs import show_text
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_predictions

TABLE = Table()
tries = TABLE.tries
NOT_OURS = "what is there was not written by a command; move it, or give another --out"


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


def make_workdir(folder):
    """The folder of a run as far as it is read before a network is."""
    return write_workdir(folder / "run", tiny_config())


@tries("predictions.png, but it is an input; move", names=["out/predictions.png"])
@tries(f"out/a.json, but {NOT_OURS}.", names=["a.png"], draw=["out/a.json"])
@tries("would be written twice; rename the input, or", names=["predictions.png"])
@tries("but a came more than once; predict them one by", names=["a.png", "b/a.png"])
@tries("no such file (File name too long); rename", names=["x" * 251 + ".png"])
def predict_images(folder, *, names, draw=()):
    words = [f"--workdir={make_workdir(folder)}", f"--out={folder / 'out'}"]
    for name in {*names, *draw}:
        save_disc(folder / name)
    return call(predict, *words, *(folder / name for name in names))


@tries("Expected the config of a run in", out="out", run="none")
@tries("made or written (it is a file); give", out="a.png")
@tries("made or written (File name too long)", out="x" * 300)
def predict_into(folder, *, out, run="run"):
    image = save_disc(folder / "a.png")
    make_workdir(folder)
    return call(predict, f"--workdir={folder / run}", f"--out={folder / out}", image)


@tries("has been changed since a command wrote it; move it")
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


@tries("half")
def write_after_a_kill(folder):
    """What a killed command wrote is still known as its own."""
    code = "import os, sys, pathlib\nfrom dpc_jax import outputs\n"
    code += "with outputs.owning(sys.argv[1], ['a.ply']):\n"
    code += "    pathlib.Path(sys.argv[1], 'a.ply').write_text('half')\n    os._exit(9)"
    root = Path(outputs.__file__).parents[1]
    killed = subprocess.run([sys.executable, "-c", code, str(folder)], cwd=root)
    assert killed.returncode == 9
    with outputs.owning(folder, ["a.ply"]):
        return (folder / "a.ply").read_text()


@tries(NOT_OURS)
def show_over_a_photograph(folder):
    save_disc(folder / "set" / "one" / "0.png")
    photograph = save_disc(folder / "photograph.png")
    return call(data_command, "show", folder / "set", f"--out={photograph}")


@tries("views.png, but it is an input")
def fit_into_the_folder_of_its_views(folder):
    for name in ("0.png", "views.png"):
        save_disc(folder / name)
    return call(fit, folder, f"--out={folder}")


@tries(NOT_OURS)
def compare_over_a_page(folder):
    make_workdir(folder)
    (folder / "index.html").write_text("mine")
    return call(compare, folder / "run", f"--out={folder}")


@tries("cannot be read or written (File name too long); make room, or give")
def name_no_file(folder):
    return call(fit, "x" * 300)


WRONG_FLAGS = {
    fit: {
        "HERE --points=0": "--points: it must be a whole number of at least 1",
        "HERE --elevations=50,10": "--elevations: it must be two numbers",
        "HERE --learn=zoom": "--learn: names must be of",
        "HERE --speed=3": "Expected flags as --help lists them, but unrecognized",
    },
    compare: {"": "RUN", "HERE --out=curves.png": "must be a folder"},
    paper: {
        "--experiment=shapes": "--experiment: names must be of all, known_pose",
        "--category=boat": "names must be of airplane, car, chair, not boat",
        "--seeds=-1": "--seeds: seeds must be whole numbers",
        "--shapenet=none": "--shapenet must be a folder that exists",
        "--experiment=ablation --category=car": "is not made of car",
        "--category=,": "not empty",
        "--seeds=0,": "as in 0,1,2, not ''",
    },
    benchmark: {"--parts=speed,sped": "names must be of"},
    stability: {"--subjects=rays": "names must be of"},
}
WRONG_FILES = {
    fit: {
        "HERE/nowhere": "is not a folder",
        "HERE/objects": "holds folders; give one of them",
        "HERE --poses=rough": "needs the poses of",
    },
    compare: {
        "HERE/nowhere": "nowhere, but no config.json is there",
        "HERE/run": "run/report/metrics.json",
    },
    view: {
        "HERE/a.txt": "Expected a file that ends with .ply",
        "HERE/a.ply": "Expected a shape in",
        "HERE/empty": "Expected a run or shapes",
        "HERE/a.ply --port=65536": "--port must be a number from 1 to 65535",
    },
}


def give_what_is_wrong(folder, *, command, flags, status):
    for name in ("a.txt", "a.ply", "run/report/metrics.json"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("no shape")
    make_workdir(folder)
    (folder / "empty").mkdir()
    save_disc(folder / "0.png")
    save_disc(folder / "objects" / "one" / "0.png")
    before = sorted(folder.rglob("*"))
    if command not in (compare, fit, view):
        flags += f" --out={folder / 'out'}"
    said = call(command, *flags.replace("HERE", str(folder)).split())
    assert said.endswith(f"Status {status}.") and sorted(folder.rglob("*")) == before
    return said


for status, wrong in ((2, WRONG_FLAGS), (1, WRONG_FILES)):
    for command, rows in wrong.items():
        for flags, says in rows.items():
            given = {"command": command, "flags": flags, "status": status}
            tries(says, **given)(give_what_is_wrong)


@tries("/dev/null is no regular file")
def predict_a_device(folder):
    return call(predict, f"--workdir={make_workdir(folder)}", "/dev/null")


@tries("車")
def name_files_in_bytes_of_all_kinds(folder):
    """Bytes that are no UTF-8, line breaks, codes of terminals, formulas, 車."""
    names = [b"a\xff", b"a\nb", b"\x1b[31ma", b"a\xe2\x80\xaeb", b"$\\frac$"]
    names.append("車".encode())
    paths = [save_disc(folder / os.fsdecode(name + b".png")) for name in names]
    spec = DataSpec("car", kind="images", folder=".", image_size=16, crop="object")
    found, _ = read_photographs([folder], spec)
    (one,) = found
    shown = [*one.sources, *(show_text(path) for path in paths)]
    text = "".join(shown)
    assert text.isprintable() and text.encode()
    blank = np.zeros((4, 4))
    row = Example("", blank, blank, blank, np.zeros((1, 3)), None, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = [dataclasses.replace(row, name=name) for name in shown]
        draw_predictions(rows, folder / "a.png")
    return Path(shown[-1]).name


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


@tries("several colours", draw=draw_tiles)
@tries("nothing differs", draw=lambda: np.full((64, 64, 3), 180))
@tries("the largest of which is", draw=draw_spots)
@tries("of the image's border", draw=draw_cross)
def find_a_mask(_, *, draw):
    return masks.find_before_plain_background(draw().astype(np.uint8))


def draw_without_alpha(path):
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (20, 20), "red").save(path)


FAINT = "a.png, but it is nowhere more than 39 % opaque"
NO_MASK = "a_mask.png beside it, but found neither; add a mask. Status 1."


@tries(FAINT, draw=functools.partial(save_disc, alpha=100))
@tries(NO_MASK, draw=draw_without_alpha)  # --mask=auto is no answer to it
def fit_a_view(folder, *, draw):
    draw(folder / "views" / "a.png")
    return call(fit, folder / "views", f"--out={folder / 'out'}")


@pytest.mark.parametrize("attempt, says", TABLE)
def test_a_command_ends_in_a_result_or_in_a_sentence(attempt, says, tmp_path):
    assert_try_says(attempt, says, tmp_path)
