"""What the pages say exists: links, files, functions, fields, public names."""

import dataclasses
import doctest
import inspect
import json
import re
import tomllib

import jax
import numpy as np
import pytest
from document_pages import LOG, NOTEBOOK, PAGES, ROOT, list_spans

import dpc_jax
from dpc_jax.config import Config, build_config

PACKAGE = ROOT / "dpc_jax"
ALL = [*PAGES, LOG, ROOT / "CHANGELOG.md"]
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


@pytest.mark.parametrize("page", ALL, ids=lambda page: page.name)
def test_every_link_and_picture_exists(page):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@each_page
def test_every_file_and_function_that_a_page_names_exists(page):
    """Such as `configs/car.py`, `learning/losses.py` and `files.py: digest`."""
    for span in list_spans(page):
        found = re.fullmatch(r"([\w/]+\.(?:py|sh|md|sbatch|toml))(?:: (\w+))?", span)
        if found is None:
            continue
        paths = [place / found[1] for place in (PACKAGE, ROOT)]
        path = next((path for path in paths if path.exists()), None)
        assert path is not None, f"{page.name} names {found[1]}"
        if found[2]:
            defined = rf"^(def|class) {found[2]}\b|^{found[2]}\b.* ="
            assert re.search(defined, path.read_text("utf-8"), flags=re.M), span


def test_every_page_that_the_code_names_exists():
    for folder in ("dpc_jax", "configs", "launch", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".sh", ".env", ".sbatch"):
                text = path.read_text(encoding="utf-8")
                for name in re.findall(r"\bdocs/\w+\.md", text):
                    assert (ROOT / name).exists(), f"{path.name} names {name}"


@each_page
def test_every_field_and_variant_that_a_page_names_exists(page):
    """Such as `train.steps`, `:known_pose` and `configs/car.py:paper,128`."""
    sections = {
        section.name: {field.name for field in dataclasses.fields(section.type)}
        for section in dataclasses.fields(Config)
        if dataclasses.is_dataclass(section.type)
    }
    for span in list_spans(page):
        field = re.fullmatch(r"(\w+)\.(\w+)(?:=\S*)?", span)
        if field and field[1] in sections and field[2] not in ("py", "md", "sh"):
            assert field[2] in sections[field[1]], f"{page.name} names {span}"
        variant = re.fullmatch(r"(?:configs/(\w+)\.py)?:([a-z0-9_,]+)", span)
        if variant:
            assert build_config(variant[1] or "car", variant[2]).variant == variant[2]


def test_extras_that_pages_install_exist():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for page in PAGES:
        for names in re.findall(r"'(?:\.|dpc_jax)\[([\w,]+)\]'", page.read_text()):
            assert set(names.split(",")) <= set(project["optional-dependencies"])


def test_the_reference_has_every_public_name():
    pages = [page.read_text("utf-8") for page in (ROOT / "docs" / "api").glob("*.md")]
    named = set(re.findall(r"^::: [\w.]+\.(\w+)$", "\n".join(pages), re.MULTILINE))
    assert named == set(dpc_jax._NAMES)


@pytest.mark.parametrize("name", sorted(dpc_jax._NAMES))
def test_the_reference_says_what_every_argument_is(name):
    """Where a docstring lists arguments or fields, it lists all of them."""
    value = getattr(dpc_jax, name)
    text = inspect.getdoc(value) or ""
    asked = set()
    if dataclasses.is_dataclass(value):
        asked = {field.name for field in dataclasses.fields(value)}
        asked -= {"parent", "name"}  # of a flax module
    elif inspect.isfunction(value):
        parameters = inspect.signature(value).parameters.values()
        asked = {p.name for p in parameters if p.kind.name[:3] != "VAR"}
    listed = re.findall(r"^  (\w+(?:, \w+)*): ", text, flags=re.MULTILINE)
    if "Args:" in text or "Attributes:" in text:
        assert asked <= {n for names in listed for n in names.split(", ")}


# Read now: the command `dpc_jax.fit` takes the function's name where it is imported.
FUNCTIONS = {name: getattr(dpc_jax, name) for name in sorted(dpc_jax._NAMES)}
FUNCTIONS = {name: f for name, f in FUNCTIONS.items() if inspect.isfunction(f)}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_public_function_says_what_it_returns_and_its_example_holds(name):
    function = inspect.unwrap(FUNCTIONS[name])
    assert "Returns:" in (function.__doc__ or "")
    names = {"dpc_jax": dpc_jax, "jax": jax, "jnp": jax.numpy, "np": np}
    (test,) = doctest.DocTestFinder(recurse=False).find(function, name, globs=names)
    assert test.examples
    said = []
    failed, _ = doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert not failed, "".join(said)


def test_the_notebook_is_kept_with_its_pictures_and_without_errors():
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    outputs = [o for c in cells if c["cell_type"] == "code" for o in c["outputs"]]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 6
    assert all(output["output_type"] != "error" for output in outputs)
