"""What is made of finished runs: of each seed by itself, kept, and said with spread."""

import json

import pytest

from dpc_jax.experiments import analyses
from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.report.measures import LABELS, make_measures
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.experiments.runs import Request, list_runs

(TRANSFER,) = (e for e in EXPERIMENTS if e.name == "correspondences")


@pytest.fixture
def analyze(tmp_path, monkeypatch):
    """Calls the analysis of three seeds; counts what it is asked to make."""
    calls = []

    def transfer(folder, workdir):
        calls.append(workdir.name)
        seed = int(workdir.name[-1])
        if f"seed{seed}" in broken:
            raise ValueError("Expected parts, but there are none; leave it out.")
        (folder / "picture.png").write_text(workdir.name)
        metrics = {"right_part": 0.7 + 0.1 * seed, "shapes": 4, "by": {}}
        return metrics, [folder / "picture.png"]

    broken = set()
    monkeypatch.setattr(analyses, "load_function", lambda name: transfer)
    request = Request("correspondences", "cpu")
    outcomes = {
        run.name: Outcome(run, tmp_path / run.name, metrics={"chamfer": 4.0})
        for run in list_runs([request])
    }
    results = Results([request], outcomes)

    def call(*without):
        broken.update(without)
        calls.clear()
        found = analyses.analyze(results, tmp_path / "analyses")["correspondences"]
        return found, list(calls)

    return call


def test_every_seed_is_analyzed_once_and_the_mean_has_its_spread(analyze):
    found, calls = analyze()
    assert len(calls) == 3
    assert found.metrics["right_part"] == pytest.approx(0.8)
    assert found.metrics["shapes"] == 4
    (picture,) = found.figures
    assert picture.read_text().endswith("seed0")
    table = make_measures("correspondences", found)
    assert table is not None and [value for _, value in table.rows] == [
        "0.8 ± 0.1 (n = 3)",
        "4",
    ]
    again, calls = analyze()
    assert again == found and not calls


def test_a_seed_that_cannot_be_analyzed_is_left_out(analyze):
    found, _ = analyze("seed2")
    assert not found.problem and found.metrics["right_part"] == pytest.approx(0.75)


def test_where_no_seed_can_be_analyzed_the_first_says_why(analyze):
    found, _ = analyze("seed0", "seed1", "seed2")
    assert "there are none" in found.problem and not found.metrics


def test_every_measure_has_a_name_for_people():
    """Those of the correspondences and interpolations that docs/ show."""
    assert {"right_part", "follows", "distance"} <= LABELS["correspondences"].keys()
    assert {"largest_step", "nearest_halfway"} <= LABELS["interpolation"].keys()
    names = [name for name, labels in LABELS.items() if labels]
    assert set(names) == {e.name for e in EXPERIMENTS if e.analysis}
    assert json.dumps(LABELS).count("_") == sum(
        key.count("_") for labels in LABELS.values() for key in labels
    )
