"""What the documents name exists: files, functions, tests, pictures, links."""

import ast
import dataclasses
import inspect
import itertools
import re
from pathlib import Path

import pytest

import dpc_jax

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "dpc_jax"
PAGES = sorted(
    [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    + [*(ROOT / "docs").rglob("*.md")]
)


def find_source(name):
    """A file that a page names: from the package's folder or the repository's."""
    for place in (PACKAGE / name, ROOT / name):
        if place.exists():
            return place
    return None


def list_functions():
    """(file, name) of the functions that docs/equations.md names."""
    text = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
    for row in re.findall(r"^\|(.*)\|$", text, flags=re.MULTILINE):
        file = None
        for quoted in re.findall(r"`([^`]+)`", row):
            if match := re.fullmatch(r"([\w/]+\.py): (\w+)", quoted):
                file = match[1]
                yield file, match[2]
            elif re.fullmatch(r"[\w/]+\.py", quoted):
                file = quoted
                yield file, None
            elif file and re.fullmatch(r"[A-Za-z]\w+", quoted):
                yield file, quoted  # further functions of the same file


FUNCTIONS = sorted(set(list_functions()), key=str)


def test_the_equations_name_functions_and_tests():
    files = {file for file, _ in FUNCTIONS}
    assert {"learning/choice/winners.py", "render/termination.py"} <= files
    assert sum(file.startswith("tests/") for file in files) >= 10


@pytest.mark.parametrize("file, name", FUNCTIONS)
def test_every_function_and_test_of_the_equations_exists(file, name):
    path = find_source(file)
    assert path is not None, f"there is no {file}"
    if name is not None:
        text = path.read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {name}\b", text, flags=re.MULTILINE)


EQUATIONS = (
    (1, "learning/choice/winners.py", "compare_winners"),
    (2, "learning/choice/hindsight.py", "choose_candidate"),
    (3, "render/volume.py", "fill_volume"),
    (4, "render/termination.py", "end_rays"),
    (5, "render/projection.py", "project_signals"),
    (6, "evaluation/chamfer.py", "chamfer_distance"),
    (7, "render/exact/gaussians.py", "sum_gaussians"),
)


@pytest.mark.parametrize("number, file, name", EQUATIONS)
def test_the_function_of_an_equation_begins_with_its_number(number, file, name):
    """So that `grep -rn "Eq. 3" dpc_jax` answers with it."""
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    (function,) = (n for n in tree.body if getattr(n, "name", None) == name)
    first_line = (ast.get_docstring(function) or "").splitlines()[0]
    assert re.search(rf"\bEq\. {number}\b", first_line), first_line
    assert (file, name) in FUNCTIONS  # and docs/equations.md names it


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_and_picture_of_a_page_exists(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    pattern = r"`((?:dpc_jax|configs|launch|tests|docs|render|learning|data|networks|"
    pattern += r"evaluation|reporting|measure|shapes|config|run)/[\w/]+\.(?:py|sh|md))"
    for name in re.findall(pattern, text):
        assert find_source(name) is not None, f"{page.name} names {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_function_that_a_page_names_with_its_file_exists(page):
    """Such as `learning/losses.py: student_loss`."""
    text = page.read_text(encoding="utf-8")
    for file, name in re.findall(r"`([\w/]+\.py): (\w+)`", text):
        path = find_source(file)
        assert path is not None, f"{page.name} names {file}"
        found = re.search(
            rf"^(def|class) {name}\b|^{name}\b.* =", path.read_text("utf-8"), re.M
        )
        assert found, f"{page.name} names {file}: {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_an_empty_line_ends_every_table(page):
    """Else GitHub shows the text that follows as one more row."""
    lines = page.read_text(encoding="utf-8").splitlines()
    for number, (line, after) in enumerate(itertools.pairwise(lines), start=2):
        if line.startswith("|") and after.strip():
            assert after.startswith("|"), f"{page.name}:{number}: {after}"


def test_every_picture_is_on_a_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = [p for p in (ROOT / "docs" / "images").rglob("*") if p.is_file()]
    unused = [p.name for p in pictures if p.name not in pages]
    assert len(pictures) > 20 and unused == []


def test_every_page_is_in_the_menu():
    """The site's build says so too, but takes a minute."""
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        assert f" {page.relative_to(ROOT / 'docs')}\n" in menu, page.name


def test_the_reference_has_every_public_name():
    pages = [page.read_text("utf-8") for page in (ROOT / "docs" / "api").glob("*.md")]
    named = set(re.findall(r"^::: [\w.]+\.(\w+)$", "\n".join(pages), re.MULTILINE))
    assert named == set(dpc_jax._NAMES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_that_a_page_runs_exists(page):
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"-m (dpc_jax[\w.]*)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists()


@pytest.mark.parametrize("name", sorted(dpc_jax._NAMES))
def test_the_reference_says_what_every_argument_is(name):
    """Where a docstring lists arguments or fields, it lists all of them."""
    value = getattr(dpc_jax, name)
    text = inspect.getdoc(value) or ""
    if dataclasses.is_dataclass(value):
        asked = {field.name for field in dataclasses.fields(value)}
        asked -= {"parent", "name"}  # of a flax module
    elif inspect.isfunction(value):
        parameters = inspect.signature(value).parameters.values()
        asked = {p.name for p in parameters if p.kind.name[:3] != "VAR"}
    else:
        asked = set()
    listed = re.findall(r"^  (\w+(?:, \w+)*): ", text, flags=re.MULTILINE)
    if "Args:" in text or "Attributes:" in text:
        assert asked <= {n for names in listed for n in names.split(", ")}
