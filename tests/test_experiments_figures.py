"""Figures of the paper's page: lines that are told apart, colours that stay."""

import json
import os

import numpy as np
from PIL import Image

from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.report import figures
from dpc_jax.experiments.report.pictures import _copy_small, copy_pictures
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.experiments.runs import Request, list_runs
from dpc_jax.reporting import style


def make_results(folder, request, seconds):
    """Results whose runs, one after the other, took so many seconds a record."""
    outcomes = {}
    for number, run in enumerate(list_runs([request])):
        workdir = folder / run.name
        workdir.mkdir()
        lines = [
            {"step": i, "seconds": i * seconds(number), "chamfer": 9.0 - i}
            for i in (1, 2, 3)
        ]
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (workdir / "metrics.jsonl").write_text(text)
        outcomes[run.name] = Outcome(run, workdir, metrics={"chamfer": 5.0})
    return Results([request], outcomes)


def draw(monkeypatch, *arguments):
    """The figures that a function draws, unsaved."""
    drawn = []
    monkeypatch.setattr(style, "save_figure", lambda figure, path: drawn.append(figure))
    figures._draw_run_times(*arguments)
    return drawn


def test_every_row_has_a_line_of_its_own_and_one_legend(tmp_path, monkeypatch):
    request = Request("known_pose", "quick")
    results = make_results(tmp_path, request, lambda number: 60.0)
    (figure,) = draw(monkeypatch, results, EXPERIMENTS[0], tmp_path)
    lines = figure.axes[0].lines
    looks = {(line.get_color(), line.get_linestyle()) for line in lines}
    assert len(looks) == len(lines) > len(style.SERIES)
    (legend,) = figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert named == [row.label for row in EXPERIMENTS[0].rows if row.variant]


def test_minutes_are_logarithmic_only_where_runs_differ_by_much(tmp_path, monkeypatch):
    request = Request("known_pose", "quick")
    for name, seconds, scale in (
        ("alike", lambda number: 60.0, "linear"),
        ("long", lambda number: 20.0 * 3**number, "log"),
    ):
        (tmp_path / name).mkdir()
        results = make_results(tmp_path / name, request, seconds)
        (figure,) = draw(monkeypatch, results, EXPERIMENTS[0], tmp_path)
        assert {axes.get_xscale() for axes in figure.axes} == {scale}


def test_a_small_copy_keeps_the_colours_of_a_scale(tmp_path):
    """A scale covers few pixels beside images of other colours."""
    rng = np.random.default_rng(0)
    image = rng.integers(60, 110, (300, 300, 3)).astype(np.uint8)
    ramp = np.linspace(0, 255, 100).astype(np.uint8)
    image[-3:, :100] = np.stack([ramp, 0 * ramp, 255 - ramp], axis=-1)  # blue to red
    Image.fromarray(image).save(tmp_path / "report.png")
    copy = _copy_small(tmp_path / "report.png", tmp_path / "copy.png")
    kept = np.asarray(Image.open(copy).convert("RGB"), np.float64)
    # A palette by counts of pixels is wrong by 100 and more there.
    assert np.abs(kept - image)[-3:, :100].max() < 40


def test_a_picture_is_copied_again_only_where_the_run_has_a_newer_one(tmp_path):
    """A page is written after every run, and a copy takes a second."""
    results = make_results(
        tmp_path, Request("unknown_pose", "quick"), lambda number: 1.0
    )
    (row, *_) = (row for row in EXPERIMENTS[1].rows if row.variant)
    (outcome,) = results.list_outcomes(EXPERIMENTS[1], row, "chair")
    picture = outcome.workdir / "report" / EXPERIMENTS[1].picture
    picture.parent.mkdir()

    def copy(color):
        Image.new("RGB", (8, 8), color).save(picture)
        ((small, _),) = copy_pictures(results, EXPERIMENTS[1], tmp_path)
        assert small == tmp_path / f"{outcome.run.name}_{picture.name}"
        return small, Image.open(small).convert("RGB").getpixel((0, 0))

    small, first = copy("red")
    os.utime(picture, (0, 0))  # an old picture, whose copy was made since
    os.utime(small, (10, 10))
    copy_pictures(results, EXPERIMENTS[1], tmp_path)
    assert small.stat().st_mtime == 10
    assert (first, copy("blue")[1]) == ((255, 0, 0), (0, 0, 255))
