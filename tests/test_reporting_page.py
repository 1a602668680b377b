"""Figures, tables and the report: complete, self-contained, safe to open."""

import base64
import dataclasses
import io
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
import trimesh
from PIL import Image
from report_pages import make_example

from dpc_jax.evaluation.metrics import COMPARED_METRICS, MISSING, REQUIRED_METRICS
from dpc_jax.reporting import figures, gallery, signals, spheres, tables
from dpc_jax.reporting.examples import Example, SignalImages
from dpc_jax.reporting.page import write_report
from dpc_jax.reporting.web import viewer
from dpc_jax.run import comparison

METRICS = {
    "pose_accuracy": np.float64(0.875),
    "pose_median_error_deg": 7.25,
    "chamfer": np.float32(3.5),
    "precision": 1.5,
    "coverage": 2.0,
    "train_seconds": 321,
    "flip_share": float("nan"),
    "seed": 0,
}
RECORDS = [
    {"step": 10, "seconds": 1.0, "loss": 0.5},
    {"step": 20, "seconds": 2.0, "loss": float("nan")},
    {"step": 30, "seconds": 3.0, "loss": 0.25, "pose_accuracy": 0.2, "chamfer": 6.0},
    {"step": 60, "seconds": 6.0, "pose_accuracy": 0.6, "pose_median_error_deg": 12.0},
]


def example(name="car", colors=True, surface=True, size=16):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.4, (50, 3))
    return Example(
        name=name,
        image=rng.integers(0, 256, (size, size, 3)).astype(np.uint8),
        target=rng.uniform(size=(size, size)),
        predicted=rng.uniform(size=(2 * size, 2 * size)),  # of its own size
        points=points,
        colors=rng.uniform(size=(50, 3)) if colors else None,
        pose_error_deg=4.5,
        surface=points if surface else None,
    )


def report(folder, **changes):
    arguments = {
        "title": "Cars & <b>bold</b>",
        "metrics": METRICS,
        "records": RECORDS,
        "examples": [example(), example("car", colors=False, surface=False)],
        "pose_errors": np.array([[1.0, 20.0], [40.0, 179.0]]),
        "shares": [0.5, 0.495, 0.005],
        "warnings": ["3 meshes < 5 could not be read."],
        "config_text": "a = '<script>alert(1)</script>'",
    }
    return write_report(folder, **(arguments | changes))


NO_FIGURES = {"records": (), "examples": (), "shares": None}


def test_wrong_views_are_explained_where_there_are_any(tmp_path):
    more = {"wrong_half_turn_share": 0.8, "wrong_object_share": 0.05}
    names = [f"car <{i}>" for i in range(40)]
    path = report(tmp_path, metrics=METRICS | more, lost=names, **NO_FIGURES)
    page = path.read_text("utf-8")
    assert "What the wrong views are" in page and "80.0" in page
    assert "car &lt;29&gt;, ..." in page and "car &lt;30&gt;" not in page
    page = report(tmp_path, **NO_FIGURES).read_text("utf-8")
    assert "What the wrong views are" not in page


def test_clouds_reach_the_page_as_they_are_and_errors_with_them():
    shown = make_example("car")
    clouds = viewer.describe_clouds(shown)

    def decode(text, dtype):
        return np.frombuffer(base64.b64decode(text), dtype)

    predicted = clouds["predicted"]
    points = decode(predicted["points"], "<i2") / 32767 * predicted["reach"]
    # Half a step of 16 bits, and the reach is stated to six places.
    np.testing.assert_allclose(points.reshape(-1, 3), shown.points, atol=1e-5)
    # A tenth too large: at the ends of the axes 0.04, 0.02, 0.015 away.
    errors = decode(predicted["errors"], "u1") / 255 * viewer.FARTHEST
    assert 0.005 < errors.min() and errors.max() < 0.041
    many = dataclasses.replace(shown, points=np.zeros((9000, 3)), colors=None)
    count = len(decode(viewer.describe_clouds(many)["predicted"]["points"], "<i2"))
    assert count == 3 * 2000


class Tags(HTMLParser):
    """All tags with their attributes, and whether every one opened was closed."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def picture(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "report"
    assert report(path) == path / "index.html"
    return path


def test_metrics_are_sorted_strict_json_with_all_that_is_required(folder):
    text = (folder / "metrics.json").read_text()
    metrics = json.loads(text, parse_constant=pytest.fail)
    assert list(metrics) == sorted(metrics)
    assert set(REQUIRED_METRICS) <= set(metrics)
    assert metrics["pose_accuracy"] == 0.875
    assert metrics["flip_share"] is None  # NaN is not JSON
    assert '\n  "chamfer": 3.5,\n' in text


def test_the_page_reaches_for_nothing_outside_itself_but_its_own_files(folder):
    text = (folder / "index.html").read_text(encoding="utf-8")
    # Of what is packed in base64, any letters can follow two strokes.
    plain = re.sub(r"base64,[^\"]*|(?<=id=\"plotly\">)[^<]*", "", text)
    plain = re.sub(r"(?<=id=\"clouds\">)[^<]*", "", plain)
    assert not re.search(r"(?:https?:)?//[a-z]", plain)
    tags = Tags(text)
    assert tags.open == []
    assert {tag for tag, _ in tags.found} & {"link", "iframe"} == set()
    assert not any("src" in attrs for tag, attrs in tags.found if tag == "script")
    links = [attrs["href"] for tag, attrs in tags.found if tag == "a"]
    assert len(links) == 5
    assert all((folder / link).is_file() for link in links)


def test_the_page_carries_its_figures_and_none_is_blank(folder):
    tags = Tags((folder / "index.html").read_text(encoding="utf-8"))
    images = [attrs for tag, attrs in tags.found if tag == "img"]
    kinds = [attrs["src"].partition(",")[0] for attrs in images]
    # Curves, pose errors, candidates; of each example input, silhouettes, two shapes.
    assert kinds.count("data:image/png;base64") == 3
    assert kinds.count("data:image/webp;base64") == 8
    for attrs in images:
        assert attrs["alt"]
        data = base64.b64decode(attrs["src"].partition(",")[2])
        assert picture(data).std() > 5.0  # a blank picture has none


def test_what_users_wrote_is_shown_and_never_run(folder):
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert "<h1>Cars &amp; &lt;b&gt;bold&lt;/b&gt;</h1>" in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert "3 meshes &lt; 5 could not be read." in text
    assert "87.5" in text


def test_examples_of_one_name_keep_their_files_apart(folder):
    names = sorted(path.name for path in (folder / "points").iterdir())
    assert names == ["car.glb", "car.ply", "car_2.glb", "car_2.ply"]
    read = trimesh.load(folder / "points" / "car.ply")
    # Stored in float32: coordinates under 0.5 keep 3e-8.
    np.testing.assert_allclose(read.vertices, example().points, atol=1e-7)


def test_a_name_of_an_example_cannot_leave_the_folder(tmp_path):
    names = ["../../evil", "a/b c", "é", "..", "a_b", "A_B"]
    examples = [example(name) for name in names]
    report(
        tmp_path / "report",
        examples=examples,
        records=(),
        pose_errors=None,
        shares=None,
    )
    written = {path.stem for path in (tmp_path / "report" / "points").glob("*.ply")}
    # Names that differ by case alone would be one file on some systems.
    assert written == {"evil", "a_b_c", "example", "example_2", "a_b", "A_B_2"}
    assert [path.name for path in tmp_path.iterdir()] == ["report"]


def test_sections_without_data_are_left_out(tmp_path):
    missing = dict.fromkeys(("records", "examples", "warnings"), ())
    path = report(tmp_path, **missing, pose_errors=None, shares=None, config_text="")
    assert {p.name for p in tmp_path.iterdir()} == {"index.html", "metrics.json"}
    assert "<img" not in path.read_text(encoding="utf-8")


def test_the_same_run_gives_the_same_bytes(tmp_path, folder):
    again = tmp_path / "elsewhere"
    report(again)
    for path in folder.rglob("*.*"):
        assert (again / path.relative_to(folder)).read_bytes() == path.read_bytes()


def test_a_missing_metric_is_named_before_anything_is_written(tmp_path):
    few = {name: 1.0 for name in REQUIRED_METRICS if name != "chamfer"}
    with pytest.raises(ValueError, match="there is none for chamfer"):
        report(tmp_path / "report", metrics=few)
    with pytest.raises(
        ValueError, match=r"'extra' must be a single value, but has shape \(2,\)"
    ):
        report(tmp_path / "report", metrics=METRICS | {"extra": [1.0, 2.0]})
    assert not (tmp_path / "report").exists()


def test_curves_bear_missing_quantities(tmp_path):
    all_of_them = figures.draw_curves(RECORDS, tmp_path / "all.png").read_bytes()
    loss_alone = figures.draw_curves(RECORDS[:1], tmp_path / "loss.png").read_bytes()
    assert picture(all_of_them).shape[0] == 2 * picture(loss_alone).shape[0]
    figures.draw_curves([], tmp_path / "none.png")
    many = [{"seconds": t, "loss": 0.0} for t in range(200)]  # no logarithm of zero
    figures.draw_curves(many, tmp_path / "zero.png")


def test_a_single_curve_takes_the_whole_picture(tmp_path):
    lines = [{"seconds": t, "side": 64, "loss": 1 / t} for t in range(1, 5)]
    for draw in (figures.draw_fit, figures.draw_curves):
        drawn = picture(draw(lines, tmp_path / "one.png").read_bytes())
        right = drawn[:, -drawn.shape[1] // 3 :]
        assert np.ptp(right[..., :3].astype(int)) > 100, draw.__name__


def test_stages_and_living_candidates_are_drawn_over_run_time(tmp_path):
    lines = [
        {"step": s, "seconds": s / 10, "loss": 1.0, "head_shares": [1 - s / 99, s / 99]}
        for s in range(1, 60, 5)
    ]
    draw = figures.draw_curves
    plain = picture(draw(lines, tmp_path / "a.png").read_bytes())
    stages = [(0, "10 points"), (30, "20 points"), (900, "never reached")]
    marked = picture(draw(lines, tmp_path / "b.png", stages=stages).read_bytes())
    changed = np.any(plain != marked, axis=(0, 2))
    # One line in each of the two panels, thin, with one label; nothing past the end.
    assert 2 <= np.count_nonzero(np.diff(changed.astype(int)) == 1) < 20
    assert np.count_nonzero(changed) < 0.05 * changed.size
    dead = [line | {"head_shares": [1.0, 0.0]} for line in lines]
    assert np.any(picture(draw(dead, tmp_path / "c.png").read_bytes()) != plain)


def test_the_time_axis_follows_the_seconds_not_the_order_of_lines(tmp_path):
    lines = [{"seconds": float(t), "chamfer": 9.0 - t} for t in (1, 2, 5, 6)]
    mixed = [lines[index] for index in (2, 0, 3, 1)]
    a = figures.draw_curves(lines, tmp_path / "a.png").read_bytes()
    b = figures.draw_curves(mixed, tmp_path / "b.png").read_bytes()
    assert a == b


def test_every_entry_of_the_histograms_legend_has_its_mark(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures.style, "save_figure", lambda f, path: drawn.append(f))
    figures.draw_pose_errors([1.0, 20.0, 40.0, 179.0], tmp_path / "a.png")
    (figure,) = drawn
    (legend,), (axes,) = figure.legends, figure.axes
    lines, boxes = legend.get_lines(), legend.get_patches()
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[0].startswith("30°") and texts[1].startswith("median")
    assert texts[2] == "beyond 150° (front as back): 25 %"
    assert len(lines) == 2 and {line.get_linestyle() for line in lines} == {"-", "--"}
    (box,) = boxes  # in the colour of the bars from 150° to 180°, and of no other
    colors = [bar.get_facecolor() for bar in axes.patches]
    assert [color == box.get_facecolor() for color in colors] == [False] * 30 + [
        True
    ] * 6


def test_a_histogram_of_no_or_broken_errors_is_refused(tmp_path):
    with pytest.raises(ValueError, match="0 of 0"):
        figures.draw_pose_errors([], tmp_path / "a.png")
    with pytest.raises(ValueError, match="1 of 2 are outside"):
        figures.draw_pose_errors([1.0, np.nan], tmp_path / "a.png")


def test_drawing_leaves_pyplot_alone(tmp_path):
    code = (
        "import sys; from dpc_jax.reporting import figures, gallery;"
        "figures.draw_candidates([1.0], sys.argv[1]);"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.png")]
    assert subprocess.run(command, check=False).returncode == 0


def test_drawing_says_nothing_of_the_cache_of_fonts_that_it_makes(tmp_path):
    code = (
        "import logging; logging.basicConfig(level=logging.INFO);"
        "from dpc_jax.reporting import figures"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"MPLCONFIGDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert list(tmp_path.glob("fontlist*.json"))
    assert "font" not in result.stderr


def test_writing_points_does_not_load_matplotlib_or_trimesh():
    code = (
        "import sys, dpc_jax.reporting.export;"
        "sys.exit(bool({'matplotlib', 'trimesh'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_predictions_without_examples_are_refused(tmp_path):
    with pytest.raises(ValueError, match="examples must be at least one"):
        gallery.draw_predictions([], tmp_path / "a.png")


@pytest.mark.parametrize(
    ("view", "nearest"), [((0, 0), 0), ((90, 0), 1), ((123, 90), 2), ((180, 0), 3)]
)
def test_a_viewer_sees_the_side_its_angles_name(view, nearest):
    corners = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]], float)
    assert np.argmax(spheres.view_points(corners, view)[:, 2]) == nearest


def test_seen_from_the_front_up_is_up_and_the_left_side_is_at_the_right():
    up, left = spheres.view_points([[0.0, 0, 1], [0, 1.0, 0]], (0.0, 0.0))
    # Sines and cosines of 0, in float64.
    np.testing.assert_allclose(up, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(left, [1, 0, 0], atol=1e-15)


def test_the_difference_is_positive_where_the_prediction_is_too_large():
    target, predicted = np.zeros((2, 2)), np.zeros((4, 4))
    predicted[0, 0], target[1, 1] = 1.0, 0.5
    got = gallery.silhouette_difference(predicted, target)
    assert got.shape == (4, 4)
    assert got[0, 0] == 1.0
    assert np.all(got[2:, 2:] == -0.5)


def test_a_table_escapes_its_cells_and_refuses_a_row_of_another_length():
    assert tables.format_table(["a", "b", "c"], [["x|y", 1, "two\nlines"]]) == (
        "| a | b | c |\n| --- | ---: | --- |\n| x\\|y | 1 | two lines |\n"
    )
    assert "| ---: | --- |" in tables.format_table(["a", "b"], [], align="rl")
    with pytest.raises(TypeError, match="2 columns"):
        tables.format_table(["a", "b"], [[1]])


def test_a_comparison_says_which_figures_are_absent():
    whole = dict.fromkeys(COMPARED_METRICS, 1.0)
    runs = {"a": whole, "b": whole | {"pose_accuracy": None}}
    assert comparison.name_absent({"a": whole}) == ""
    said = comparison.name_absent(runs)
    assert said.startswith(f"{MISSING} is absent: b had no truth")
    assert "given the poses" in said
    # What is no column of the table has no dash: voxels have no denser cloud.
    cells = {n: v for n, v in whole.items() if not n.startswith("dense_")}
    assert len(cells) < len(whole)
    assert comparison.name_absent({"a": whole, "cells": cells}) == ""
    # Nor has a column that no run has figures for.
    known = {n: v for n, v in whole.items() if "pose" not in n}
    assert comparison.name_absent({"known": known}) == ""


def add_signals(shown, names=("silhouette", "depth", "color")):
    rng = np.random.default_rng(1)
    images = {}
    for name in names:
        ends = (12, 12, 3) if name == "color" else (12, 12)
        pair = rng.uniform(1.6, 2.4, (2, *ends)) - (0 if name == "depth" else 1.5)
        share = np.pad(np.ones((8, 8)), 2)
        images[name] = SignalImages(pair[0], pair[1], share, share.T)
    return dataclasses.replace(shown, signals=images)


def test_rendered_images_of_signals_are_a_figure_of_their_own(tmp_path):
    others = {"records": (), "pose_errors": None, "shares": None}
    silhouettes = [add_signals(example(), ("silhouette",))]
    report(tmp_path / "plain", examples=silhouettes, **others)
    assert not (tmp_path / "plain" / "signals.png").exists()
    report(tmp_path / "all", examples=[add_signals(example())], **others)
    page = (tmp_path / "all" / "index.html").read_text(encoding="utf-8")
    assert "<h2>Rendered images</h2>" in page
    assert picture((tmp_path / "all" / "signals.png").read_bytes()).std() > 5.0


def test_rendered_images_are_drawn_of_examples_that_have_some(tmp_path):
    with pytest.raises(ValueError, match="at least one with images of signals"):
        signals.draw_signals([example()], tmp_path / "none.png")
