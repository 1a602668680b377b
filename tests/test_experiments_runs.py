"""Rows of the experiments: each is a config that works, each config one run."""

import pytest

from dpc_jax.experiments.catalogue import EXPERIMENTS, Row
from dpc_jax.experiments.runs import SIZES, Request, Run, declare_run

ALL = ("airplane", "car", "chair")


def list_names(*experiments, **fields):
    return [run.name for run in Request(experiments, **fields).list_runs()]


@pytest.mark.parametrize("size", SIZES)
def test_every_run_has_a_config_that_works_and_a_name_of_its_own(size):
    configs = {}
    request = Request(size=size, categories=ALL, seeds=(3,))
    rows = [
        run
        for experiment in request.list_experiments()
        for category in request.list_categories(experiment)
        for row in experiment.rows
        for run in request.list_row_runs(row, category)
    ]
    runs = {run.name: run for run in rows}
    assert all(runs[run.name] == run for run in rows)  # one name, one config
    for name, run in runs.items():
        config = run.load_config()
        assert (
            config.seed == 3 and config.category.removesuffix("_simple") == run.category
        )
        # At the quick size several numbers of points come to the same.
        if size != "quick":
            first = configs.setdefault(config, name)
            assert first == name, f"{first} and {name} are the same config"


def test_experiments_share_runs_of_the_same_config():
    def name(experiment):
        return set(list_names(experiment, categories=("chair",), seeds=(0,)))

    assert "chair-paper-known_pose-64-seed0" in name("known_pose") & name("ablation")
    assert name("correspondences") == name("interpolation") < name("unknown_pose")


def test_the_full_size_is_the_paper_and_the_others_shorten_it():
    def load(size):
        names = ("unknown_pose", "known_pose")
        request = Request(names, size=size, categories=("car",), seeds=(0,))
        return {run.name: run.load_config() for run in request.list_runs()}

    full, short = load("full"), load("cpu")
    papers = [name for name in full if "paper" in name]
    assert {full[name].train.steps for name in papers} == {600_000}
    assert full["car-paper-known_pose-128-seed0"].render.num_points == 16_000
    assert full["car-paper-naive-seed0"].pose.num_heads == 1
    # What is shorter keeps the paper's method.
    for name in papers:
        assert short[name].pose == full[name].pose
        assert short[name].network.layers == "paper"
        assert short[name].train.steps < full[name].train.steps
        rate = {config[name].train.learning_rate for config in (full, short)}
        assert rate == {1e-4}
    # The defaults are configs/car.py.
    default = Run("", "car", "", 0, (("category", "car_simple"),)).load_config()
    assert short["car-shipped-seed0"] == full["car-seed0"] == default


def test_long_runs_have_fewer_seeds_unless_some_are_asked_for():
    few = list_names("known_pose", categories=("car",))
    many = list_names("known_pose", categories=("car",), seeds=(0, 1))
    # Runs at 128, and of a row that says that it is long.
    for long in ("known_pose-128-seed", "128-epcg-seed", "64-ours_v-seed"):
        assert sum(long in name for name in few) == 1
        assert sum(long in name for name in many) == 2
    assert sum("known_pose-64-seed" in name for name in few) == 3
    # First seeds of all rows come before second ones.
    seeds = [run.seed for run in Request(("unknown_pose",)).list_runs()]
    assert seeds == sorted(seeds) and set(seeds) == {0, 1, 2}


def test_the_flags_of_a_run_say_its_config():
    # What a row says comes before what the size says.
    changes = {"render.keep_start": 1.0, "train.steps": 7}
    row = Row("", variant="known_pose,64", changes=changes, tag="a")
    run = declare_run(row, "chair", 2, Request(size="quick"))
    flags = run.list_flags()
    assert flags[0] == "--config=chair:paper,known_pose,64"
    assert {"--config.seed=2", "--config.render.keep_start=1.0"} <= set(flags)
    assert run.name == "chair-paper-known_pose-64-a-seed2"
    config = run.load_config()
    assert config.render.keep_start == 1.0 and config.train.steps == 7


def test_shapenet_takes_the_place_of_procedural_shapes(tmp_path):
    row = Row("", variant="naive")
    for shapenet, category in (("", "car_simple"), (str(tmp_path), "car")):
        run = declare_run(row, "car", 0, Request(shapenet=shapenet))
        config = run.load_config()
        assert (config.data.shapenet, config.category) == (shapenet, category)


def test_precision_and_coverage_of_the_ablation_add_up_to_chamfer():
    (ablation,) = (e for e in EXPERIMENTS if e.name == "ablation")
    assert len(ablation.rows) == 7
    for values in (row.published["chair"] for row in ablation.rows):
        total = values["precision"] + values["coverage"]
        assert values["chamfer"] == pytest.approx(total, abs=0.011)
