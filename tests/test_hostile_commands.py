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
from tiny_runs import tiny_config

import dpc_jax.fit as fit
from dpc_jax import compare, outputs, predict
from dpc_jax.config import replace_fields, to_json
from dpc_jax.data import DataSpec
from dpc_jax.data import __main__ as data_command
from dpc_jax.data.sets import masks
from dpc_jax.data.sets.photographs import read_photographs
from dpc_jax.outputs import show_text
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.run import prediction
from dpc_jax.run.prediction import objects as predicted_objects
from dpc_jax.run.workdir import claim_workdir

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


def make_workdir(folder, **changes):
    """The folder of a run as far as it is read before a network is."""
    workdir = folder / "run"
    workdir.mkdir()
    (workdir / "config.json").write_text(to_json(tiny_config(**changes)))
    return workdir


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


@tries("but it cannot be used (config must have no other fields")
def train_in_a_folder_with_a_config_of_another_program(folder):
    (folder / "config.json").write_text('{"editor": "mine"}')
    try:
        claim_workdir(folder, tiny_config())
    finally:
        assert (folder / "config.json").read_text() == '{"editor": "mine"}'


@tries("cannot be read or written (File name too long); make room, or give")
def name_no_file(folder):
    return call(fit, "x" * 300)


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


@tries("['RUN/data', '/asked']")
def refine_with_a_cache_folder_of_others(folder):
    """Where data are kept for a workdir whose config says elsewhere."""
    config = replace_fields(tiny_config(), {"data": {"cache_dir": "/elsewhere"}})
    places = []

    def stop(config, workdir):
        places.append(config.data.cache_dir)
        raise ValueError("Enough.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predicted_objects, "read_config", lambda _: config)
        patch.setattr(predicted_objects, "load_checkpoint", stop)
        for data in (None, Path("/asked")):
            with contextlib.suppress(ValueError):
                request = prediction.PredictRequest([], folder, folder, data=data)
                predicted_objects.predict_objects([], request)
    return [place.replace(str(folder), "RUN") for place in places]


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
