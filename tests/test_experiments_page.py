"""The page, from made-up finished runs: whose numbers stand where, what is missing."""

import json
import os
import re

import pytest

from dpc_jax import paper
from dpc_jax.config import VARIANTS, to_json
from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.declarations import Row
from dpc_jax.experiments.report.blocks import Figure
from dpc_jax.experiments.report.page import publish
from dpc_jax.experiments.report.tables import format_summary, make_table
from dpc_jax.experiments.report.targets import check_targets
from dpc_jax.experiments.results import Outcome, Results, Summary, summarize
from dpc_jax.experiments.runs import Request, Run, Source, list_runs
from dpc_jax.experiments.suite import Place, _Suite
from dpc_jax.experiments.systems import SYSTEMS, list_systems
from dpc_jax.run.workdir import hold_workdir

KNOWN, UNKNOWN, ABLATION = EXPERIMENTS[:3]
CHAMFER = {"32": 5.0, "64": 4.0, "128": 3.0}


def make_up(run):
    """Metrics of a run: seed 1 is 0.2 worse than seed 0, cars 1 better than chairs."""
    resolution = next((r for r in CHAMFER if f"-{r}-" in run.name), "64")
    shift = 0.2 * run.seed - (run.category == "car")
    naive = "naive" in run.name
    return {
        "chamfer": CHAMFER[resolution] + shift,
        "precision": 1.5,
        "coverage": CHAMFER[resolution] + shift - 1.5,
        "pose_accuracy": 0.4 if naive else 0.9 if "gt_pose" in run.name else 0.8,
        "pose_median_error_deg": 40.0 if naive else 5.0,
        "train_seconds": 120.0,
        "peak_memory_gb": 1.5,
        "train_models": 12,
        "test_models": 4,
    }


def make_results(*requests, without=()):
    """Results of made-up metrics; runs with a word of `without` are missing."""
    outcomes = {
        run.name: Outcome(run, None, metrics=make_up(run))
        if not any(word in run.name for word in without)
        else Outcome(run, None)
        for run in list_runs(requests)
    }
    return Results(requests, outcomes)


def read_row(table, category, label):
    """Cells of a row by their heads."""
    (row,) = (r for r in table.rows if list(r[:2]) == [category, label])
    return dict(zip(table.heads, row, strict=True))


CARS_AND_CHAIRS = Request(
    "known_pose,unknown_pose", "quick", categories=("car", "chair"), seeds=(0, 1)
)


def test_the_paper_s_number_stands_beside_the_mean_and_spread_of_ours():
    table = make_table(make_results(CARS_AND_CHAIRS), KNOWN)
    row = read_row(table, "chair", "Ours, 64²")
    assert row["Chamfer distance (×100), paper"] == "4.15"
    # 4.0 and 4.2: standard deviation 0.2 / √2.
    assert row["Chamfer distance (×100), ours"] == "4.10 ± 0.14 (n = 2)"
    assert (row["Runs"], row["Minutes"], row["Memory (GB)"]) == ("2", "2.0", "1.5")
    mean = read_row(table, "mean", "Ours, 64²")
    # The paper's cars and chairs, without its airplanes: (2.98 + 4.15) / 2.
    assert mean["Chamfer distance (×100), paper"] == "3.57"
    # Chairs 4.1, cars 3.1; the mean of two has 1/√2 of the spread of one.
    assert mean["Chamfer distance (×100), ours"] == "3.60 ± 0.10 (n = 2)"


def test_a_row_that_is_measured_has_no_runs_and_no_poses():
    label = "Mean shape of the training set"
    results = make_results(CARS_AND_CHAIRS)
    found = {("unknown_pose", label, "car"): {"chamfer": 6.5}}
    measured = Results(results.requests, results._outcomes, found)
    row = read_row(make_table(measured, UNKNOWN), "car", label)
    assert row["Chamfer distance (×100), ours"] == "6.50 (n = 1)"
    assert row["Pose accuracy (%), ours"] == row["Pose accuracy (%), paper"] == "–"
    assert row["Runs"] == "measured on the data" and not row["Minutes"]
    without = read_row(make_table(results, UNKNOWN), "car", label)
    assert without["Chamfer distance (×100), ours"] == "–"


def test_every_other_system_is_said_to_follow_and_to_differ():
    """And every row of one has its variant."""
    described = {
        e.name: [s.variant for s in list_systems([r.variant or "" for r in e.rows])]
        for e in EXPERIMENTS
    }
    assert described["known_pose"] == ["drc", "ptn", "ours_v", "epcg"]
    assert described["unknown_pose"] == ["ours_v", "mvc"]
    assert not any(described[name] for name in ("ablation", "color", "points"))
    for system in SYSTEMS:
        assert system.variant in VARIANTS
        assert "Followed:" in system.describe() and "Differs:" in system.describe()


def test_what_is_missing_says_so():
    results = make_results(CARS_AND_CHAIRS, without=("naive", "128-seed1"))
    naive = read_row(make_table(results, UNKNOWN), "car", "Ours-naive")
    assert naive["Runs"] == "not run yet"
    assert naive["Chamfer distance (×100), ours"] == "–"
    assert naive["Chamfer distance (×100), paper"] == "4.14"
    long = read_row(make_table(results, KNOWN), "car", "Ours, 128²")
    assert long["Runs"] == "1 of 2"
    assert long["Chamfer distance (×100), ours"] == "2.00 (n = 1)"


def test_a_single_run_has_no_spread():
    assert summarize([None, float("nan")]) is None
    assert summarize([4.0, None]) == Summary(4.0, None, 1)
    assert format_summary("chamfer", Summary(4.0, None, 1)) == "4.00 (n = 1)"
    assert format_summary("pose_accuracy", summarize([0.5, 0.6])) == (
        "55.0 ± 7.1 (n = 2)"
    )


def find_target(targets, words):
    (target,) = (t for t in targets if all(word in t.text for word in words))
    return target


def test_targets_are_checked_from_the_figures(monkeypatch):
    targets = check_targets(make_results(CARS_AND_CHAIRS), {})
    falls = find_target(targets, ("car", "falls from 32"))
    assert falls.met and falls.reached == "4.10, 3.10, 2.10"
    assert find_target(targets, ("car", "(naive, ours)")).met
    assert find_target(targets, ("car", "(naive, defaults)")).met
    assert find_target(targets, ("chair", "upper bound")).met
    # The same Chamfer with known and unknown pose is not below.
    assert find_target(targets, ("chair", "below unknown")).met is False
    monkeypatch.setitem(CHAMFER, "128", 4.5)
    assert not find_target(
        check_targets(make_results(CARS_AND_CHAIRS), {}), ("car", "falls from 32")
    ).met


def test_a_target_whose_runs_are_missing_is_neither_met_nor_missed():
    targets = check_targets(make_results(CARS_AND_CHAIRS, without=("naive",)), {})
    assert find_target(targets, ("car", "(naive, ours)")).met is None


def test_the_order_of_the_ablation_names_the_pairs_that_differ():
    request = Request("ablation", "quick")
    (target,) = check_targets(make_results(request), {})
    assert target.met  # equal rows are not the other way round
    outcomes = {run.name: run for run in list_runs([request])}
    worse = {"chair-known_pose-64-seed0": 9.0}
    made = {
        name: Outcome(run, None, metrics={"chamfer": worse.get(name, 4.0)})
        for name, run in outcomes.items()
    }
    (target,) = check_targets(Results([request], made), {})
    assert not target.met
    assert target.reached.startswith("6 of 21 pairs")
    assert "Full, 8000 points and No dropout" in target.reached


def test_a_baseline_becomes_a_row_by_one_declaration():
    """As PTN would, once there is a variant of that name."""
    row = Row("PTN, 32²", "PTN, 32", "known_pose,32", {"train.steps": 9}, "ptn")
    request = Request("known_pose", "quick")
    (run,) = request.list_row_runs(row, "chair")
    assert run.name == "chair-known_pose-32-ptn-seed0"
    results = Results([request], {run.name: Outcome(run, None, metrics=make_up(run))})
    found = results.summarize(KNOWN, row, "chair", "chamfer")
    assert found == Summary(5.0, None, 1)
    assert KNOWN.table.find(row.published, "chair", "chamfer") == 5.10


def test_rows_that_renders_cannot_train_are_left_out_and_the_table_says_why(tmp_path):
    (tmp_path / "03001627").mkdir()
    request = Request("known_pose", "quick", Source("renders", str(tmp_path)))
    runs = list_runs([request])
    assert not [run.name for run in runs if "epcg" in run.name]
    for run in runs:
        run.load_config()
    table = make_table(
        Results([request], {r.name: Outcome(r, None) for r in runs}), KNOWN
    )
    reasons = {cells[1]: cells[-3] for cells in table.rows}
    assert reasons["EPCG, 32²"] == "renders have no views from fixed places"
    assert reasons["PTN, 32²"] == "not run yet"


# The whole command, on finished runs.


def finish_runs(folder, *requests, without=" "):
    """Folders of finished runs, as `dpc_jax.main` leaves them."""
    for run in (run for run in list_runs(requests) if without not in run.name):
        workdir = folder / "runs" / run.name
        (workdir / "report").mkdir(parents=True)
        (workdir / "config.json").write_text(to_json(run.load_config()))
        (workdir / "report" / "metrics.json").write_text(json.dumps(make_up(run)))
        (workdir / "report" / "index.html").write_text("report")
        lines = [
            {
                "step": 10 * i,
                "seconds": 30.0 * i,
                "chamfer": 9 - i,
                "pose_accuracy": 0.1,
            }
            for i in (1, 2, 3)
        ]
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (workdir / "metrics.jsonl").write_text(text)


def test_the_command_writes_the_page_of_what_is_finished(tmp_path, capsys):
    out, page = tmp_path / "out", tmp_path / "docs" / "paper.md"
    finish_runs(out, Request("known_pose,unknown_pose", "quick"))
    flags = [f"--out={out}", "--size=quick", "--experiment=known_pose,unknown_pose"]
    assert paper.main([*flags, f"--page={page}"]) == 0
    said = capsys.readouterr().out
    assert "19 of 19 runs are finished." in said and f"Page: {out}/index.html" in said
    html, text = (out / "index.html").read_text(), (out / "paper.md").read_text()
    for words in ("nothing about how well", "on the data", "4.15", "12 models"):
        assert words in html and words in text
    assert "## Targets" not in text
    assert "Not asked for here: ablation" in text
    assert html.count("data:image/png") == text.count("![") == 3
    for written in (out / "paper.md", page):
        for link in re.findall(r"\]\((.+?\.png)\)", written.read_text()):
            assert (written.parent / link).is_file(), link


@pytest.mark.parametrize("text", ['{"chamfer": 4', "null", '{"chamfer": "four"}'])
def test_a_damaged_report_is_never_a_number(text, tmp_path, capsys):
    finish_runs(tmp_path, Request("depth", "quick"))
    (path,) = tmp_path.glob("runs/chair-known_pose-32-seed0/report/metrics.json")
    path.write_text(text)
    flags = [f"--out={tmp_path}", "--size=quick", "--experiment=depth"]
    assert paper.main([*flags, "--no-training"]) == 0
    text = (tmp_path / "paper.md").read_text()
    found = re.search(r"\| Known pose, silhouettes \| (\S+)", text)
    assert found and found[1] == "–"


def test_only_failures_of_what_was_asked_for_fail_the_command(
    tmp_path, capsys, monkeypatch
):
    load = Run.load_config

    def refuse(run):
        if "ptn" in run.name:
            raise ValueError("A config that cannot work.")
        return load(run)

    finish_runs(tmp_path, Request("known_pose", "quick"), without="ptn")
    monkeypatch.setattr(Run, "load_config", refuse)
    flags = [f"--out={tmp_path}", "--size=quick", "--experiment=known_pose"]
    assert paper.main([*flags, "--only=*-32-seed0"]) == 0
    assert "ptn" not in capsys.readouterr().out
    assert paper.main([*flags, "--only=*-ptn-seed0"]) == 1
    assert "A config that cannot work." in capsys.readouterr().out


def test_targets_are_shown_for_runs_whose_figures_count(tmp_path):
    finish_runs(tmp_path, Request("known_pose", "cpu", categories=("chair",)))
    flags = [f"--out={tmp_path}", "--size=cpu", "--experiment=known_pose"]
    assert paper.main([*flags, "--category=chair", "--no-training"]) == 0
    text = (tmp_path / "paper.md").read_text()
    assert "## Targets" in text and "nothing about how well" not in text


def test_a_folder_remembers_what_it_was_asked_for(tmp_path, capsys):
    finish_runs(tmp_path, Request("known_pose,unknown_pose", "quick"))
    flags = [f"--out={tmp_path}", "--size=quick"]
    assert paper.main([*flags, "--experiment=known_pose"]) == 0
    assert "Shape and pose" not in (tmp_path / "paper.md").read_text()
    assert paper.main([*flags, "--experiment=unknown_pose"]) == 0
    text = (tmp_path / "paper.md").read_text()
    assert "## Shape with known pose" in text and "## Shape and pose" in text
    assert paper.main([f"--out={tmp_path}", "--size=cpu"]) == 1
    assert "must have one size, but it was begun with quick" in capsys.readouterr().err


def test_a_page_beside_the_runs_takes_a_tenth_of_their_time_at_most(tmp_path):
    suite = _Suite(Place(tmp_path, tmp_path), [Request("ablation", "quick")])
    page = suite.write()
    page.unlink()
    suite.writing = 1e6  # seconds that it took
    suite._write_now_and_then()
    assert not page.exists()
    suite.written -= 1e8
    suite._write_now_and_then()
    assert page.exists()


def test_a_page_without_runs_has_the_paper_s_numbers(tmp_path, capsys):
    flags = [f"--out={tmp_path}", "--experiment=ablation", "--no-training"]
    assert paper.main(flags) == 0
    text = (tmp_path / "paper.md").read_text()
    assert "0 of 21 runs are finished." in text and "4.89" in text
    assert text.count("not run yet") == 7 and "runs are missing" in text
    assert "None of its runs is finished yet." in text
    assert not (tmp_path / "runs").exists()


def test_a_second_command_of_the_same_folder_is_refused(tmp_path, capsys):
    with hold_workdir(tmp_path):
        assert paper.main([f"--out={tmp_path}", "--size=quick"]) == 1
    error = capsys.readouterr().err
    assert f"but process {os.getpid()} on" in error and error.count("\n") == 1
    assert not (tmp_path / "requests.json").exists()


@pytest.mark.parametrize(
    "flags, words",
    [
        ("--experiment=shapes", "--experiment must be all, or of known_pose"),
        ("--size=huge", "invalid choice: 'huge'"),
        ("--category=boat", "--category must be of airplane, car, chair"),
        ("--seeds=-1", "--seeds must be whole numbers"),
        ("--source=shapenet", "--folder must be a folder that exists"),
        ("--folder=here", "--folder must be left out"),
        ("--experiment=ablation --category=car", "is not made of car"),
        ("--experiment=depth --only=*-depth-*,boat-*", "boat-* fits none of its 36"),
        ("--experiment=known_pose,ablation --category=car", "ablation is not made"),
        ("--category=,", "but it has an empty name"),
        ("--seeds=0,", "but it has an empty one"),
        ("--only=", "but an empty name fits none"),
        ("--page=tests", "but tests is a folder"),
        ("--page=README.md/paper.md", "README.md is no folder"),
        ("--source=shapenet --folder=tests", "Expected the folder 0"),
        ("--at-once=-2", "--at-once must be at least 1"),
        ("--steps=3", "unrecognized arguments: --steps=3"),
    ],
)
def test_a_wrong_flag_is_said_in_one_sentence(flags, words, tmp_path, capsys):
    out = tmp_path / "out"
    assert paper.main([f"--out={out}", *flags.split()]) == 2
    error = capsys.readouterr().err
    assert words in error and error.startswith("Error: ") and error.count("\n") == 1
    assert not out.exists()


def test_a_published_page_has_each_different_figure_of_one_name_once(tmp_path):
    blocks = []
    for folder, byte in (("points", b"a"), ("covariance", b"b"), ("color", b"a")):
        path = tmp_path / folder / "error.png"
        path.parent.mkdir()
        path.write_bytes(byte)
        blocks.append(Figure(path, folder))
    page = publish(tmp_path / "docs" / "paper.md", blocks)
    copies = sorted((page.parent / "images" / "paper").iterdir())
    assert [copy.read_bytes() for copy in copies] == [b"b", b"a"]
    text = page.read_text(encoding="utf-8")
    assert all(f"images/paper/{copy.name}" in text for copy in copies)
