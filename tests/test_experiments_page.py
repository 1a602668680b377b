"""The page, from made-up finished runs: whose numbers stand where, what is missing."""

import os
import re

import pytest
from tiny_runs import write_workdir

from dpc_jax import paper
from dpc_jax.experiments import results as module
from dpc_jax.experiments import training
from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.page import list_measures, tabulate
from dpc_jax.experiments.results import Outcome, Results, analyze
from dpc_jax.experiments.runs import Request
from dpc_jax.run.workdir import hold_workdir

KNOWN, UNKNOWN = EXPERIMENTS[:2]
(TRANSFER,) = (e for e in EXPERIMENTS if e.name == "correspondences")
CHAMFER = {"32": 5.0, "64": 4.0, "128": 3.0}
CHAMFER_PAPER, CHAMFER_OURS = (
    f"Chamfer distance (×100), {whose}" for whose in ("paper", "ours")
)


def make_up(run):
    """Metrics of a run: seed 1 is 0.2 worse than seed 0, cars 1 better than chairs."""
    resolution = next((r for r in CHAMFER if f"-{r}-" in run.name), "64")
    shift = 0.2 * run.seed - (run.category == "car")
    return {
        "chamfer": CHAMFER[resolution] + shift,
        "pose_accuracy": 0.8,
        "train_seconds": 120.0,
        "peak_memory_gb": 1.5,
        "mean_shape_chamfer": {"car": 6.5}.get(run.category),
        "steps": 10,
        "train_models": 12,
        "test_models": 4,
    }


def make_results(request, *, without=()):
    """Results of made-up metrics; runs with a word of `without` are missing."""
    outcomes = {
        run.name: Outcome(run, None, metrics=make_up(run))
        if not any(word in run.name for word in without)
        else Outcome(run, None)
        for run in request.list_runs()
    }
    return Results(request, outcomes)


def read_row(results, experiment, category, label):
    """Cells of a row by their heads."""
    heads, rows = tabulate(results, experiment, category)
    (row,) = (r for r in rows if r[0] == label)
    return dict(zip(heads, row, strict=True))


CARS_AND_CHAIRS = Request(
    ("known_pose", "unknown_pose"), "quick", categories=("car", "chair"), seeds=(0, 1)
)


def test_the_paper_s_number_stands_beside_the_mean_and_spread_of_ours():
    results = make_results(CARS_AND_CHAIRS)
    row = read_row(results, KNOWN, "chair", "Ours, 64²")
    assert row[CHAMFER_PAPER] == "4.15"
    # 4.0 and 4.2: standard deviation 0.2 / √2.
    assert row[CHAMFER_OURS] == "4.10 ± 0.14"
    assert (row["Runs"], row["Minutes"], row["Memory (GB)"]) == ("2", "2.0", "1.5")
    assert not any(head.startswith("Precision") for head in row)  # nobody's
    mean = "Chamfer distance, mean training shape (×100), ours"
    assert read_row(results, UNKNOWN, "car", "MVC")[mean] == "6.50 ± 0.00"
    assert mean not in row  # unknown


def test_what_is_missing_says_so():
    results = make_results(CARS_AND_CHAIRS, without=("naive", "128-seed1"))
    naive = read_row(results, UNKNOWN, "car", "Ours-naive")
    assert naive["Runs"] == "not run yet"
    assert (naive[CHAMFER_OURS], naive[CHAMFER_PAPER]) == ("–", "4.14")
    long = read_row(results, KNOWN, "car", "Ours, 128²")
    assert (long["Runs"], long[CHAMFER_OURS]) == ("1 of 2", "2.00")


def test_every_seed_is_analysed_and_the_first_one_is_shown(tmp_path, monkeypatch):
    def transfer(folder, workdir):
        (folder / "picture.png").write_text(workdir.name)
        measures = {"Share": 0.7 + 0.1 * int(workdir.name[-1])}
        return measures, [(folder / "picture.png", "A picture.")]

    monkeypatch.setitem(module._OF_A_RUN, "correspondences", transfer)
    request = Request(("correspondences",), "cpu")
    outcomes = {
        run.name: Outcome(run, tmp_path / run.name, metrics={"chamfer": 4.0})
        for run in request.list_runs()
    }
    found = analyze(Results(request, outcomes), TRANSFER, tmp_path)
    assert list_measures(found) == [("Share", "0.8 ± 0.1")]
    ((picture, caption),) = found.figures
    assert picture.read_text().endswith("seed0") and caption == "A picture."

    def refuse(folder, workdir):
        if workdir.name.endswith("seed1"):
            raise ValueError("Expected parts, but there are none; leave it out.")
        return transfer(folder, workdir)

    monkeypatch.setitem(module._OF_A_RUN, "correspondences", refuse)
    failed = analyze(Results(request, outcomes), TRANSFER, tmp_path)
    assert "there are none" in failed.problems[0]
    assert len(failed.measures) == 2 and failed.figures == found.figures


# The whole command, on finished runs.


def start(folder, names, *flags):
    """Status of the command for experiments at the quick size."""
    flags = f"--out={folder}", "--size=quick", f"--experiment={names}", *flags
    return paper.main(list(flags))


def read_page(folder):
    return (folder / "index.html").read_text(encoding="utf-8")


def finish_runs(folder, request, without=" "):
    """Folders of finished runs, as `dpc_jax.main` leaves them."""
    for run in (run for run in request.list_runs() if without not in run.name):
        workdir = folder / "runs" / run.name
        write_workdir(workdir, run.load_config(), metrics=make_up(run))
        (workdir / "report" / "index.html").write_text("report")


def test_the_command_writes_the_page_of_what_is_finished(tmp_path, capsys):
    finish_runs(tmp_path, Request(("known_pose", "unknown_pose"), "quick"))
    assert start(tmp_path, "known_pose,unknown_pose") == 0
    said = capsys.readouterr().out
    assert "16 of 16 runs are finished." in said
    assert f"Page: {tmp_path}/index.html" in said
    page = read_page(tmp_path)
    for words in (
        "nothing about how well",
        "4.15",
        "12 models",
        "in 10 steps",
        "Not asked for here: ablation",
    ):
        assert words in page


@pytest.mark.parametrize("text", ['{"chamfer": 4', '{"chamfer": "four"}'])
def test_a_damaged_report_is_never_a_number(text, tmp_path):
    finish_runs(tmp_path, Request(("depth",), "quick"))
    (path,) = tmp_path.glob("runs/chair-paper-known_pose-32-seed0/report/metrics.json")
    path.write_text(text)
    assert start(tmp_path, "depth", "--no-training") == 0
    page = read_page(tmp_path)
    (shown,) = re.findall("<td>Known pose, silhouettes</td><td>([^<]+)", page)
    assert shown == "–"


def test_a_run_that_fails_fails_the_command_and_the_page_says_why(
    tmp_path, monkeypatch
):
    def fail(jobs, **_):
        (job,) = (job for job in jobs if job.read_metrics() is None)
        return {job.run.name: "A run that cannot work."}

    finish_runs(tmp_path, Request(("known_pose",), "quick"), without="ptn")
    monkeypatch.setattr(training, "train_missing", fail)
    assert start(tmp_path, "known_pose", "--no-training") == 0
    assert "A run that cannot work." not in read_page(tmp_path)
    assert start(tmp_path, "known_pose") == 1
    assert "A run that cannot work." in read_page(tmp_path)


def test_a_page_without_runs_has_the_paper_s_numbers(tmp_path):
    flags = [f"--out={tmp_path}", "--experiment=ablation", "--no-training"]
    assert paper.main(flags) == 0
    text = read_page(tmp_path)
    assert "0 of 21 runs are finished." in text and "4.89" in text
    assert text.count("not run yet") == 7
    assert "None of its runs is finished yet." in text
    assert not (tmp_path / "runs").exists()


def test_a_second_command_of_the_same_folder_is_refused(tmp_path, capsys):
    with hold_workdir(tmp_path):
        assert start(tmp_path, "all") == 1
    error = capsys.readouterr().err
    assert f"but process {os.getpid()} on" in error and error.count("\n") == 1
