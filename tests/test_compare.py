"""Runs side by side: seeds together, what differs is marked, every curve is found."""

import dataclasses
import json
import re
import statistics

import pytest
from tiny_runs import tiny_config, write_workdir

from dpc_jax import compare
from dpc_jax.config import replace_fields
from dpc_jax.reporting import style
from dpc_jax.reporting.groups import group_runs
from dpc_jax.run.comparison import find_workdirs, read_runs


def write_run(folder, *, seed=0, accuracy=None, **changes):
    """A workdir of a run that is finished where an accuracy is given."""
    config = dataclasses.replace(tiny_config(seed=seed), variant=changes.pop("v", ""))
    metrics = {"pose_accuracy": accuracy, "chamfer": 4.0, "train_seconds": 90.0}
    write_workdir(
        folder, replace_fields(config, changes), metrics=metrics if accuracy else None
    )
    line = {"step": 10, "seconds": 60.0, "pose_accuracy": 0.5, "chamfer": 5.0}
    (folder / "metrics.jsonl").write_text(json.dumps(line) + "\n")
    return folder


@pytest.fixture
def runs(tmp_path):
    """Three seeds of one config, one of another, and one that is not finished."""
    folder = tmp_path / "runs"
    for seed, accuracy in enumerate((0.90, 0.92, 0.97)):
        write_run(folder / f"car-seed{seed}", seed=seed, accuracy=accuracy)
    one = {"num_heads": 1}
    write_run(folder / "car-naive-seed0", accuracy=0.4, v="naive", pose=one)
    write_run(folder / "car-long-seed0", train={"steps": 40})
    return folder


def test_seeds_of_one_config_share_a_row_and_what_sets_others_apart_is_marked(runs):
    groups = {g.name: g for g in group_runs(read_runs(find_workdirs([runs])))}
    assert list(groups) == ["car-long", "car-naive", "car"]
    assert [run.name for run in groups["car"].runs] == [
        f"car-seed{i}" for i in range(3)
    ]
    spread = statistics.stdev([0.90, 0.92, 0.97])
    found = groups["car"].summarize("pose_accuracy")
    assert tuple(found) == pytest.approx((0.93, spread))
    shown = [group.describe("pose_accuracy") for group in groups.values()]
    assert shown == ["–", "40.0", "93.0 ± 3.6"]
    differs = [group.differs for group in groups.values()]
    assert differs == [{"train.steps": 40}, {"pose.num_heads": 1}, {}]


def test_what_does_not_change_the_result_sets_no_runs_apart(tmp_path):
    write_run(tmp_path / "a-seed0", accuracy=0.5, v="64", log={"every": 3})
    write_run(tmp_path / "a-seed1", seed=1, accuracy=0.5, run={"devices": 2})
    assert len(group_runs(read_runs(find_workdirs([tmp_path])))) == 1


def test_the_page_has_each_run_its_settings_and_its_curves_and_fetches_nothing(
    runs, tmp_path, capsys
):
    out = tmp_path / "out"
    assert compare.main([str(runs), f"--out={out}"]) == 0
    printed = capsys.readouterr().out
    assert "| car, 3 seeds | 93.0 ± 3.6 |" in printed
    assert "| car-long-seed0 (step 10 of 40) | – |" in printed
    page = (out / "index.html").read_text(encoding="utf-8")
    assert all(folder.name in page for folder in runs.iterdir())
    assert "<mark>pose.num_heads 1</mark>" in page
    assert "step 10 of 40" in page and "90 ± 0" in page  # seconds
    assert not re.search(r"""(src|href)=["'](https?:)?//""", page)
    # Three groups, a line for each run in both panels.
    assert (out / "curves.svg").read_text("utf-8").count("stroke-width: 1.3") == 2 * 5


def test_thirty_groups_have_looks_of_their_own():
    looks = [style.pick_series(index) for index in range(30)]
    assert len({(look["color"], look["linestyle"]) for look in looks}) == 30


def test_runs_of_the_same_name_are_told_apart_by_their_folders(tmp_path):
    folders = [write_run(tmp_path / name / "car-seed0") for name in ("old", "new")]
    names = [run.name for run in read_runs(find_workdirs(folders))]
    assert names == ["old/car-seed0", "new/car-seed0"]
