"""Every command of README and docs is read by the parser that its reader meets.

Nothing is trained or fetched here: a command ends once its flags are understood, and a
config once its rules are checked. tests/test_document_runs.py runs them in miniature.
"""

import argparse
import dataclasses
import importlib
import re
import sys
import tomllib

import pytest
from absl import flags
from document_blocks import (
    PAGES,
    ROOT,
    fill_in,
    find_module,
    list_blocks,
    list_commands,
    list_spans,
)

from dpc_jax import main
from dpc_jax.config import (
    Config,
    build_config,
    check,
    from_config_dict,
    replace_fields,
)

# ml_collections 1.1 loads a config file by a method that Python has deprecated.
pytestmark = pytest.mark.filterwarnings(
    "ignore:the load_module:DeprecationWarning:importlib"
)
COMMANDS = list_commands()
# Of other programs: whoever writes one here has tried it.
OTHERS = {
    ".",
    "pip",
    "jupyter",
    "pre-commit",
    "mkdocs",
    "tensorboard",
    "git",
    "cd",
    "dpc_jax",  # alone; its commands are found as modules
}


class Parsed(BaseException):
    """Raised in place of a command's work."""


@pytest.fixture
def parse_arguments(monkeypatch):
    """Gives a command to a module's own parser; fails where that refuses it."""
    parse = argparse.ArgumentParser.parse_args

    def stop(parser, *arguments):
        options = parse(parser, *arguments)
        raise Parsed(options)

    def call(module, words):
        monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
        with pytest.raises((Parsed, SystemExit)) as caught:
            module.main(words)
        monkeypatch.undo()
        if caught.type is SystemExit:  # of --help, which ends well
            assert "--help" in words and caught.value.code == 0
            return
        options = caught.value.args[0]
        if hasattr(module, "make_request"):  # what flags mean together
            module.make_request(options)

    return call


@pytest.fixture
def parse_config(monkeypatch):
    """The config that flags of a run make."""
    before = set(flags.FLAGS)

    def call(words):
        # Overrides of config fields are found in sys.argv by the flags library.
        monkeypatch.setattr(sys, "argv", ["main.py", *words])
        monkeypatch.chdir(ROOT)
        main._parse(sys.argv)
        return from_config_dict(main._CONFIG.value)

    yield call
    flags.FLAGS.unparse_flags()
    for name in set(flags.FLAGS) - before:
        delattr(flags.FLAGS, name)


def put_in_folders(config, folder):
    """The config with places that exist for those that a reader has to name."""
    (folder / "split.csv").touch()
    places = dict.fromkeys(
        ("meshes", "test_meshes", "shapenet", "renders", "images", "ground_truth"),
        str(folder),
    )
    places["split_file"] = str(folder / "split.csv")
    named = {name: p for name, p in places.items() if getattr(config.data, name)}
    return replace_fields(config, {"data": named})


def identify(command):
    return f"{command.name} {' '.join(command.words)}"


@pytest.mark.parametrize(
    "words", [pytest.param(c.words, id=identify(c)) for c in COMMANDS if c.is_whole]
)
def test_a_command_is_understood_by_its_own_parser(
    words, parse_arguments, parse_config, tmp_path
):
    words = [fill_in(word) for word in words]
    found = find_module(words)
    if found is None:
        is_script = words[0].startswith(("launch/", "tests/"))
        exists = (ROOT / words[0]).exists() if is_script else words[0] in OTHERS
        assert exists, f"no test knows how to try {' '.join(words)}"
        return
    name, arguments = found
    if not arguments:  # a command named alone stands for what it can do
        return
    if name == "dpc_jax.main":
        check(put_in_folders(parse_config(arguments), tmp_path))
    else:
        name += ".__main__" * (ROOT / name.replace(".", "/")).is_dir()
        parse_arguments(importlib.import_module(name), arguments)


@pytest.mark.parametrize(
    "words", [pytest.param(c.words, id=identify(c)) for c in COMMANDS if not c.is_whole]
)
def test_a_flag_that_a_page_quotes_alone_exists(words, parse_config):
    if not words[0].startswith("--config"):
        assert (ROOT / words[0]).exists()
        return
    if words[0].startswith("--config."):
        words = ["--config=car", *(w if "=" in w else f"{w}=1" for w in words)]
    parse_config([fill_in(word) for word in words])


def test_there_are_as_many_commands_as_a_reader_finds():
    """So that a change of how blocks are read does not silently leave them out."""
    assert len([c for c in COMMANDS if c.is_whole]) > 50
    assert any("--size=quick" in command.words for command in COMMANDS)
    joined = [c.words for c in COMMANDS if "--config.data.copies=12" in c.words]
    assert joined and "--config.train.repulsion_weight=0" in joined[0]


def test_every_block_says_its_language():
    assert [block.name for block in list_blocks("")] == []
    known = {"python", "sh", "text", "json"}
    assert {
        b.language for b in list_blocks(*known, "bash", "shell", "console")
    } <= known


def test_extras_that_pages_install_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = extras["optional-dependencies"]
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for names in re.findall(r"'(?:\.|dpc_jax)\[([\w,]+)\]'", text):
            assert set(names.split(",")) <= set(extras), f"{page.name}: {names}"


FIELDS = {
    section.name: {field.name for field in dataclasses.fields(section.type)}
    for section in dataclasses.fields(Config)
    if dataclasses.is_dataclass(section.type)
}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_field_of_the_config_that_a_page_names_exists(page):
    for line, span in list_spans(page):
        found = re.fullmatch(r"(?:config\.)?(\w+)\.(\w+)(?:=.*)?", span)
        if found and found[1] in FIELDS and found[2] not in ("py", "md", "sh"):
            assert found[2] in FIELDS[found[1]], f"{page.name}:{line} names {span}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_variant_that_a_page_names_builds(page):
    """Such as `configs/car.py:paper,128` and `:naive`."""
    for line, span in list_spans(page):
        found = re.fullmatch(r"(?:configs/(\w+)\.py)?:([a-z0-9_,]+)", span)
        if found:
            config = build_config(found[1] or "car", found[2])
            assert config.variant == found[2], f"{page.name}:{line} names {span}"
