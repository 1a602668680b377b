"""What the package says of itself: one version, in one place, and extras that exist."""

import re
import tomllib
from pathlib import Path

import pytest

from dpc_jax import outputs

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
EXTRAS = PROJECT["optional-dependencies"]


def test_citation_and_changelog_have_the_version_of_the_package():
    version = PROJECT["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", citation, re.M)[1] == version
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.findall(r"^## (\d\S*)", changes, re.M)
    assert released[0] == version
    parts = [tuple(map(int, name.split("."))) for name in released]
    assert parts == sorted(parts, reverse=True)


@pytest.mark.parametrize("name", ["dependencies", *EXTRAS])
def test_every_dependency_states_the_lowest_version_that_was_tried(name):
    for wanted in PROJECT["dependencies"] if name == "dependencies" else EXTRAS[name]:
        inside = re.fullmatch(r"(\w+)\[([\w,]+)\]", wanted)
        if inside is None:
            assert re.search(r"[>=]=", wanted), wanted
        elif inside[1] == "dpc_jax":
            assert set(inside[2].split(",")) <= set(EXTRAS)
        else:  # an extra of a package above, "jax[cuda12]"
            assert any(re.match(inside[1] + r"\b", d) for d in PROJECT["dependencies"])


def test_extras_that_an_error_tells_to_install_exist():
    for extras in outputs.EXTRAS.values():
        assert set(extras.split(",")) <= set(EXTRAS)
