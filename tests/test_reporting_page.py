"""Figures, tables and the report: complete, self-contained, safe to open."""

import base64
import dataclasses
import io
import json
import re

import numpy as np
import pytest
import trimesh
from PIL import Image
from report_pages import GROUPS, NO_FIGURES, make_example, make_report

from dpc_jax.evaluation.metrics import REQUIRED_METRICS
from dpc_jax.reporting import figures, tables
from dpc_jax.reporting.web import viewer

RECORDS = [
    {"step": 10, "seconds": 1.0, "loss": 0.5},
    {"step": 20, "seconds": 2.0, "loss": float("nan")},
    {"step": 30, "seconds": 3.0, "loss": 0.25, "pose_accuracy": 0.2, "chamfer": 6.0},
    {"step": 60, "seconds": 6.0, "pose_accuracy": 0.6, "pose_median_error_deg": 12.0},
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "report"
    assert make_report(path) == path / "index.html"
    return path


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "index.html").read_text(encoding="utf-8")


def picture(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def test_metrics_are_sorted_strict_json(tmp_path):
    more = {"steps": 20, "flip_share": float("nan")}
    make_report(tmp_path, **NO_FIGURES, metrics=more)
    text = (tmp_path / "metrics.json").read_text()
    metrics = json.loads(text, parse_constant=pytest.fail)
    assert list(metrics) == sorted(metrics) and set(REQUIRED_METRICS) <= set(metrics)
    assert (metrics["steps"], metrics["chamfer"]) == (20, 4.2)
    assert metrics["flip_share"] is None  # NaN is not JSON


@pytest.mark.parametrize("has_truth", [True, False])
def test_a_page_has_the_sections_that_its_data_allow(tmp_path, page, has_truth):
    if not has_truth:
        page = make_report(tmp_path, has_truth=False).read_text("utf-8")
    for title in (
        "Pose errors over azimuth",
        "Beside shapes that see no image",
        "Rendered images",
    ):
        assert (f"<h2>{title}</h2>" in page) == has_truth
    for title in ("Shapes to turn", "Predictions on test views", "Over run time"):
        assert re.search(f"<h2[^>]*>{title}</h2>", page)
    names = re.findall(r"<option value=.\d.>(\w+): car-\d</option>", page)
    assert names == list(GROUPS)
    assert ("Nearest training shape 2.00" in page) == has_truth
    tiles = re.findall(r'class="tile"><b>([^<]+)</b><span>([^<]+)', page)
    shown = [("4.20", "Chamfer distance (×100)")] if has_truth else []
    assert tiles == [*shown, ("90.0", "Silhouette overlap (%)")]


def test_the_page_reaches_for_nothing_outside_itself_but_its_own_files(folder, page):
    # Of what is packed in base64, any letters can follow two strokes.
    plain = re.sub(r"base64,[^\"]*|(?<=id=\"plotly\">)[^<]*", "", page)
    plain = re.sub(r"(?<=id=\"clouds\">)[^<]*", "", plain)
    assert not re.search(r"(?:https?:)?//[a-z]", plain)
    assert not re.search("<(link|iframe|script [^>]*src)", page)
    links = re.findall('href="([^"]*)"', page)
    assert len(links) == 7
    assert all((folder / link).is_file() for link in links)


def test_the_page_carries_its_figures_and_none_is_blank(page):
    source = r'<img[^>]* alt="[^"]+" src="data:image/(\w+);base64,([^"]*)"'
    images = re.findall(source, page)
    kinds = [kind for kind, _ in images]
    # Curves, azimuths; predictions and signals.
    assert kinds.count("png") == 2 and kinds.count("webp") == 2
    for _, data in images:
        assert picture(base64.b64decode(data)).std() > 5.0  # a blank picture has none


def test_what_users_wrote_is_shown_and_never_run(page):
    assert "<h1>Cars &amp; &lt;b&gt;more&lt;/b&gt;" in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert "3 meshes &lt; 5 could not be read." in page


def test_a_name_of_an_example_cannot_leave_the_folder_and_is_there_once(tmp_path):
    names = ["../../evil", "é", "a_b", "A_B"]
    examples = [make_example(name, has_truth=False) for name in names]
    changes = NO_FIGURES | {"examples": examples, "has_truth": False}
    make_report(tmp_path / "report", **changes)
    points = tmp_path / "report" / "points"
    # Names that differ by case alone would be one file on some systems.
    stems = ("evil", "example", "a_b", "A_B_2")
    expected = {f"{stem}.{end}" for stem in stems for end in ("glb", "ply")}
    assert {path.name for path in points.iterdir()} == expected
    assert [path.name for path in tmp_path.iterdir()] == ["report"]
    read = trimesh.load(points / "evil.ply")
    # Stored in float32: coordinates under 0.5 keep 3e-8.
    np.testing.assert_allclose(read.vertices, examples[0].points, atol=1e-7)


def test_sections_without_data_are_left_out(tmp_path):
    empty = {"warnings": (), "config_text": "", "has_truth": False}
    path = make_report(tmp_path, **NO_FIGURES, **empty)
    assert {p.name for p in tmp_path.iterdir()} == {"index.html", "metrics.json"}
    assert "<img" not in path.read_text(encoding="utf-8")


def test_clouds_reach_the_page_as_they_are_and_errors_with_them():
    def decode(text, dtype):
        return np.frombuffer(base64.b64decode(text), dtype)

    shown = make_example("car")
    predicted = viewer.describe_clouds(shown)["predicted"]
    points = decode(predicted["points"], "<f4").reshape(-1, 3)
    np.testing.assert_array_equal(points, shown.points.astype("f4"))
    # A tenth too large: at the ends of the axes 0.04, 0.02, 0.015 away.
    errors = decode(predicted["errors"], "<f4")
    assert 0.005 < errors.min() and errors.max() < 0.041
    many = dataclasses.replace(shown, points=np.zeros((9000, 3)), colors=None)
    count = len(decode(viewer.describe_clouds(many)["predicted"]["points"], "<f4"))
    assert count == 3 * 2000


def test_curves_have_a_panel_for_what_is_recorded(tmp_path):
    drawn = figures.draw_curves(RECORDS, tmp_path / "all.png").read_bytes()
    alone = figures.draw_curves(RECORDS[:1], tmp_path / "loss.png").read_bytes()
    assert picture(drawn).shape[0] == 2 * picture(alone).shape[0]
    many = [{"seconds": t, "loss": 0.0} for t in range(200)]  # no logarithm of zero
    figures.draw_curves(many, tmp_path / "zero.png")


def test_a_curve_follows_the_seconds_not_the_order_of_lines():
    lines = [{"seconds": t, "pose_accuracy": t / 10} for t in (5, 1, 2)]
    lines += [{"seconds": 3, "pose_accuracy": None}, {"seconds": None}]
    seconds, values = figures.find_curve(lines, "pose_accuracy")
    assert seconds.tolist() == [1, 2, 5]
    np.testing.assert_allclose(values, [10, 20, 50])  # percent


def test_a_table_escapes_its_cells_and_aligns_numbers():
    assert tables.format_table(["a", "b", "c"], [["x|y", 1, "two\nlines"]]) == (
        "| a | b | c |\n| --- | ---: | --- |\n| x\\|y | 1 | two lines |\n"
    )
    assert "| ---: |" in tables.format_table(["a"], [["9.0 ± 1.0"], ["–"]])
