"""Every Python block of README and docs runs, and the notebook does."""

import json
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from document_blocks import PAGES, ROOT, list_blocks

pytestmark = pytest.mark.usefixtures("quickly")
NOTEBOOKS = sorted((ROOT / "docs").glob("*.ipynb"))
# Numbers that would take a minute, and those that the test takes in their place.
SMALLER = {"tutorial.md": {"range(60)": "range(2)"}}
# Pages with a block that nothing runs here: each says why, and which test stands in.
NOT_RUN = {"correspondences.md", "point_sizes.md", "tutorial.md"}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder to run in; the environment is put back."""
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    yield tmp_path
    os.environ.clear()
    os.environ.update(before)


def run_blocks(page):
    """Run a page's blocks from the first to the last; what they have defined."""
    names: dict = {}
    for block in list_blocks("python"):
        if block.page.name != page or block.reason:
            continue
        text = block.text
        for number, smaller in SMALLER.get(page, {}).items():
            assert number in text, f"{block.name} has no {number} any more"
            text = text.replace(number, smaller)
        exec(compile(text, block.name, "exec"), names)
    return names


@pytest.mark.parametrize(
    "page", sorted({block.page.name for block in list_blocks("python")})
)
def test_the_python_of_a_page_runs(page, place):
    assert run_blocks(page) or page in NOT_RUN


def test_the_gradient_of_the_readme_is_that_of_points_and_pose(place):
    gradient = run_blocks("README.md")["gradient"]
    points = np.random.default_rng(0).normal(0, 0.1, (20, 3)).astype(np.float32)
    of_points, of_pose = gradient(
        points, np.eye(3, dtype=np.float32), np.zeros((64,) * 2)
    )
    assert of_points.shape == (20, 3) and of_pose.shape == (3, 3)
    assert np.abs(of_points).max() > 0 and np.abs(of_pose).max() > 0


def test_few_blocks_are_not_run_and_each_names_the_test_in_its_place():
    left_out = [block for block in list_blocks("python", "sh") if block.reason]
    assert {block.page.name for block in left_out} == NOT_RUN
    for block in left_out:
        (test,) = [w for w in block.reason.split() if w.startswith("tests/")]
        assert (ROOT / test).exists(), block.name


def test_comments_before_blocks_are_reasons_or_nothing():
    """A misspelt "not run" would be one that nobody reads."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- not run: ") == sum(
            bool(block.reason) for block in list_blocks("python", "sh", "text", "json")
            if block.page == page
        )  # fmt: skip


def read_cells(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return ["".join(c["source"]) for c in cells if c["cell_type"] == "code"]


@pytest.mark.slow  # half a minute; tests/docs.sh runs it too
def test_the_notebook_on_the_projection_runs_and_shows_what_it_says(place, monkeypatch):
    plt.switch_backend("Agg")
    (notebook,) = NOTEBOOKS
    names: dict = {}
    shown = []
    monkeypatch.setattr(plt, "show", lambda: (shown.append(1), plt.close("all")))
    with jax.numpy_rank_promotion("allow"):  # as a reader's JAX does
        for number, cell in enumerate(read_cells(notebook)):
            exec(compile(cell, f"cell {number}", "exec"), names)
    assert len(shown) >= 6
    assert names["share"] > 0.75  # of the points are pulled back
    assert names["overlap"].mean() > 0.85 and names["curve"][-1] < names["curve"][0] / 5
    for errors in names["by_side"].values():  # a finer grid is a better one
        assert all(np.diff(errors) < 0)
    plain, narrowed = map(np.array, names["by_sigma"].values())
    assert all(narrowed[1:] < plain[1:])  # from 0.7 voxels on
