"""Rows of the experiments: each is a config that works, each config one run."""

import dataclasses

import pytest

from dpc_jax.experiments.catalogue import EXPERIMENTS, find_experiments
from dpc_jax.experiments.declarations import Row
from dpc_jax.experiments.runs import Request, Source, declare_run, list_runs
from dpc_jax.experiments.sizes import CPU, FULL, QUICK, SIZES

ALL = ("airplane", "car", "chair")


@pytest.mark.parametrize("size", SIZES)
def test_every_run_has_a_config_that_works_and_a_name_of_its_own(size):
    configs = {}
    for run in list_runs([Request(size=size, categories=ALL, seeds=(3,))]):
        config = run.load_config()
        assert config.seed == 3 and config.category == run.category
        # At the quick size several numbers of points come to the same.
        if size != "quick":
            first = configs.setdefault(config, run.name)
            assert first == run.name, f"{first} and {run.name} are the same config"


def test_experiments_share_runs_of_the_same_config():
    def name(experiment):
        request = Request(experiment, categories=("chair",), seeds=(0,))
        return {run.name for run in list_runs([request])}

    assert "chair-known_pose-64-seed0" in name("known_pose") & name("ablation")
    assert name("correspondences") == name("interpolation") <= name("unknown_pose")
    assert name("covariance") <= name("points")


def test_the_full_size_is_the_paper_and_the_others_are_not():
    request = Request("unknown_pose,known_pose", size="full", categories=("car",))
    configs = {run.name: run.load_config() for run in list_runs([request])}
    assert {config.train.steps for config in configs.values()} == {600_000}
    assert configs["car-paper-known_pose-128-seed0"].render.num_points == 16_000
    assert configs["car-paper-naive-seed0"].pose.candidates == 1
    (run,) = list_runs([Request("interpolation", size="cpu", seeds=(0,))])
    assert run.load_config().train.steps < 10_000


def test_first_seeds_of_all_rows_come_before_second_ones():
    seeds = [run.seed for run in list_runs([Request("unknown_pose")])]
    assert seeds == sorted(seeds) and set(seeds) == {0, 1, 2}


def test_long_runs_have_fewer_seeds_unless_some_are_asked_for():
    def list_names(**fields):
        runs = list_runs([Request("known_pose", categories=("car",), **fields)])
        return [run.name for run in runs]

    # Runs at 128, and of a row that says that it is long.
    for long in ("known_pose-128-seed", "128-epcg-seed", "64-ours_v-seed"):
        assert sum(long in name for name in list_names()) == len(CPU.long_seeds) == 1
        assert sum(long in name for name in list_names(seeds=(0, 1))) == 2
    assert sum("known_pose-64-seed" in name for name in list_names()) == 3


def test_the_flags_of_a_run_say_its_config():
    row = Row("", variant="known_pose,64", changes={"render.keep_start": 1.0}, tag="a")
    run = declare_run(row, "chair", 2, QUICK, Source())
    flags = run.list_flags()
    assert flags[0].endswith("configs/chair.py:known_pose,64")
    assert {"--config.seed=2", "--config.render.keep_start=1.0"} <= set(flags)
    assert run.name == "chair-known_pose-64-a-seed2"
    config = run.load_config()
    assert config.render.keep_start == 1.0 and config.pose.known


def test_what_a_row_says_comes_before_what_the_size_says():
    row = Row("", variant="known_pose", changes={"train.steps": 700}, tag="short")
    assert declare_run(row, "car", 0, CPU, Source()).load_config().train.steps == 700


def test_two_rows_of_one_name_must_be_one_config(monkeypatch):
    rows = (Row("a", variant=""), Row("b", variant="", changes={"train.steps": 7}))
    made = dataclasses.replace(EXPERIMENTS[1], rows=rows)
    monkeypatch.setattr(Request, "list_experiments", lambda self: (made,))
    with pytest.raises(ValueError, match="must have one config, but two rows"):
        list_runs([Request()])


def test_a_field_that_configs_do_not_have_is_refused_in_a_sentence():
    row = Row("", variant="", changes={"render.colour": 1}, tag="wrong")
    with pytest.raises(ValueError, match="must have no other fields than"):
        declare_run(row, "car", 0, CPU, Source()).load_config()
    row = Row("", variant="", changes={"train.steps": "many"}, tag="wrong")
    with pytest.raises(ValueError, match="values of their types, but"):
        declare_run(row, "car", 0, CPU, Source()).load_config()
    with pytest.raises(ValueError, match="must name a variant"):
        declare_run(Row("other system"), "car", 0, CPU, Source())


def test_a_source_is_read_from_its_folder(tmp_path):
    for name in ("car/train", "car/test", "chair/train"):
        (tmp_path / name).mkdir(parents=True)
    source = Source("open", str(tmp_path))
    cars, chairs = source.list_changes("car"), source.list_changes("chair")
    assert cars["data.test_meshes"] == str(tmp_path / "car/test")
    assert "data.test_meshes" not in chairs
    assert (chairs["data.copies"], chairs["data.mix"]) == (6, 0)
    with pytest.raises(ValueError, match="launch/data.sh fetch airplane"):
        source.list_changes("airplane")
    renders = Source("renders", str(tmp_path))
    with pytest.raises(ValueError, match="Expected the folder 02958343"):
        renders.list_changes("car")
    (tmp_path / "02958343").mkdir()
    assert renders.list_changes("car") == {"data.renders": str(tmp_path)}
    row = Row("", variant="naive")
    config = declare_run(row, "car", 0, FULL, source).load_config()
    assert config.data.meshes == str(tmp_path / "car/train")


def test_a_request_says_its_command_without_paths():
    request = Request("depth", "cpu", Source("open", "/somewhere"), ("car",), (0, 1))
    assert request.write_command() == (
        "python -m dpc_jax.paper --experiment=depth --size=cpu --source=open "
        "--folder=DIR --category=car --seeds=0,1"
    )


def test_experiments_are_found_by_name():
    assert find_experiments("all") == EXPERIMENTS
    names = [e.name for e in find_experiments("depth, ablation")]
    assert names == ["ablation", "depth"]
    with pytest.raises(ValueError, match="must be all, or of known_pose"):
        find_experiments("ablation,")
