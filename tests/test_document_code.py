"""Commands of the pages are understood by their parsers, and their Python runs."""

import argparse
import importlib
import json

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from document_pages import NOTEBOOK, ROOT, list_blocks, list_commands

from dpc_jax import main
from dpc_jax.commands import COMMANDS as SHORT
from dpc_jax.commands import load_module

COMMANDS = list_commands()
NAMES = [f"{page} {' '.join(words)}" for page, words in COMMANDS]
WITH_PYTHON = sorted({page for page, _ in list_blocks("python")})
# Of other programs: whoever writes one here has tried it.
OTHERS = {".", "dpc_jax", "jupyter", "pip", "pre-commit", "python3", "tensorboard"}
# Numbers that would take a minute, and those that the test takes in their place.
SMALLER = {"range(60)": "range(2)"}


class Parsed(BaseException):
    """Raised in place of a command's work."""


def find_module(words):
    """(module, its arguments) of a command of this package, else None."""
    first, *rest = words
    if first in ("python", ".venv/bin/python"):
        return rest[1], rest[2:]
    if first == "dpc_jax" and rest[:1] and rest[0] in SHORT:
        return load_module(rest[0]).__name__.removesuffix(".__main__"), rest[1:]
    scripts = {"launch/run.sh": "dpc_jax.main", "launch/data.sh": "dpc_jax.data"}
    if first in scripts:
        return scripts[first], rest
    if first == "launch/hosts.sh":
        return "dpc_jax.main", rest[1:]
    if first == "sbatch":
        config, *rest = rest[rest.index("launch/slurm.sbatch") + 1 :]
        return "dpc_jax.main", [f"--config={config}", *rest]
    return ("dpc_jax.main", words) if first.startswith("--config") else None


def read_run_flags(words):
    """Read them as a run does; those of any config as of one."""
    given = [word.replace("=...", "=car").replace("=N", "=1") for word in words]
    if not any(word.startswith("--config=") for word in given):
        given.append("--config=car")
    main.read_flags(given)


# ml_collections loads a config file by a method that Python has deprecated.
@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning:importlib")
@pytest.mark.parametrize("page, words", COMMANDS, ids=NAMES)
def test_a_command_is_understood_by_its_own_parser(page, words, monkeypatch):
    found = find_module(words)
    if found is None:
        is_script = words[0].startswith(("launch/", "tests/"))
        assert (ROOT / words[0]).exists() if is_script else words[0] in OTHERS
        return
    name, arguments = found
    if name == "dpc_jax.main" and arguments:
        monkeypatch.chdir(ROOT)
        return read_run_flags(arguments)
    name += ".__main__" * (ROOT / name.replace(".", "/")).is_dir()
    module = importlib.import_module(name)
    if not arguments:  # a command named alone stands for what it can do
        return
    parse = argparse.ArgumentParser.parse_args

    def stop(parser, *given):
        raise Parsed(parse(parser, *given))

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    with pytest.raises((Parsed, SystemExit)) as caught:
        module.main(arguments)
    assert caught.type is Parsed or "--help" in arguments, f"{page}: {words}"


def test_there_are_as_many_commands_as_a_reader_finds():
    """So that a change of how blocks are read does not silently leave them out."""
    assert len(COMMANDS) > 50
    assert any("--size=quick" in words for _, words in COMMANDS)


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_the_python_of_a_page_runs(page, tmp_path, monkeypatch):
    """All blocks of a page, from the first to the last, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    names: dict = {}
    for place, text in list_blocks("python"):
        if place == page:
            for number, smaller in SMALLER.items():
                text = text.replace(number, smaller)
            exec(compile(text, page.name, "exec"), names)
    assert names


@pytest.mark.slow  # half a minute
def test_the_notebook_on_the_projection_runs_and_shows_what_it_says(monkeypatch):
    plt.switch_backend("Agg")
    names: dict = {}
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    with jax.numpy_rank_promotion("allow"):  # as a reader's JAX does
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), NOTEBOOK.name, "exec"), names)
    assert names["share"] > 0.75  # of the points are pulled back
    assert names["overlap"].mean() > 0.85 and names["curve"][-1] < names["curve"][0] / 5
    for errors in names["by_side"].values():  # a finer grid is a better one
        assert all(np.diff(errors) < 0)
    trilinear, quadratic = map(np.array, names["by_sigma"].values())
    assert all(quadratic < trilinear / 2)
