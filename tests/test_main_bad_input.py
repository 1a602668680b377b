"""Bad input ends with an exit status and one sentence, never with a traceback."""

import dataclasses

import pytest
from config_files import FOLDER, load_editable, refuse_flags
from tiny_runs import make_dataset

from dpc_jax.config import from_fields
from dpc_jax.outputs import explain
from dpc_jax.run import pipeline, setup
from dpc_jax.run.report.judging import judge_finally
from dpc_jax.run.workdir import FREE_FIELDS, claim_workdir, hold_workdir


@pytest.fixture
def config(tmp_path):
    config = load_editable("debug")
    config.data.cache_dir = str(tmp_path / "cache")
    return config


def refuse(config, workdir):
    """The one line of a run that is refused."""
    with pytest.raises((ValueError, OSError)) as caught:
        pipeline.run(from_fields(config.to_dict()), workdir)
    error = explain(caught.value)
    assert "\n" not in error and "Traceback" not in error
    return error


def set_field(config, field, value):
    with config.unlocked():
        config.update_from_flattened_dict({field: value})


def test_a_run_that_is_not_finished_cannot_be_judged(config, tmp_path):
    config = from_fields(config.to_dict())
    with pytest.raises(ValueError, match="config of a run in"):
        pipeline.judge(config, tmp_path / "none", judge_finally)
    assert not (tmp_path / "none").exists()
    claim_workdir(tmp_path, dataclasses.replace(config, seed=7))
    with pytest.raises(ValueError, match=r"differs in seed \(7 there, 0 here\)"):
        pipeline.judge(config, tmp_path, judge_finally)


VOXELS = {"network.shape": "voxels"}
SMALL = {"data.image_size": 16, "render.grid": 4, "render.fine_grid": 0}
MAPS = {"network.shape": "maps", "pose.source": "given"}
SAMPLED = {"pose.source": "sampled", "pose.student": "selects"}
MESHES = {"data.meshes": "HERE"}
REFUSED = [  # fields, the folder of the test as HERE, and words of the sentence
    ({"pose.num_heads": 0}, "pose.num_heads must be at least 1 (K heads), but it is 0"),
    ({"train.views_per_batch": 6}, "train.views_per_batch must be at most data.views"),
    ({"train.models_per_batch": 13}, "models_per_batch must be at most data.models"),
    ({"data.image_size": 48}, "data.image_size must be a power of two"),
    ({"render.grid": 24}, "render.grid must be a divisor of data.image_size = 32"),
    ({"render.fine_grid": 24}, "a multiple of render.grid = 16"),
    ({"render.keep_start": 0.0}, "render.keep_start must be above 0 and at most 1"),
    ({"render.scale_unit": "volume"}, "render.scale_unit must be 'peak' or 'mass'"),
    ({"train.steps": 10**20}, "at most 2,147,483,647"),
    ({"train.learning_rate": float("nan")}, "train.learning_rate must be above 0"),
    (
        {"data.meshes": "/nowhere/at/all"},
        "config.data.meshes must be a folder that exists",
    ),
    ({"train.silhouette_weight": 0.0}, "so that there is something to learn from"),
    ({"data.offset": 0.2}, "data.offset must be between 0 and 0.12"),
    ({"pose.elevation_high": -20.0}, "elevation_high must be above pose.elevation_low"),
    # What does not go together.
    ({"data.images": "HERE", "train.depth_weight": 0.1}, "0 with data.images"),
    ({"data.images": "HERE", "data.offset": 0.1}, "rendered already"),
    (
        {"data.images": "HERE", "data.shapenet": "HERE"},
        "data.images must be '' where data.shapenet",
    ),
    (
        {"train.silhouette_weight": 0.0, "train.color_weight": 1.0},
        "config.train.colors_move_points must be True",
    ),
    ({"data.fold": "0/5"}, "data.fold must be '' unless there is a folder"),
    (MESHES | {"data.fold": "5/5"}, "data.fold must be '' or PART/PARTS"),
    (MESHES | {"data.fold": "0/5", "data.test_meshes": "HERE"}, "data.fold must"),
    # Of the systems that the paper compares with.
    (VOXELS | {"network.point_size": "sigma"}, "points have no size"),
    (VOXELS | SMALL, "at least 8"),
    (MAPS | {"pose.source": "unknown"}, "pose.source must be 'given'"),
    (MAPS | {"train.color_weight": 1.0}, "train.color_weight must be 0"),
    (MAPS | {"data.images": "HERE"}, "network.shape must be 'points' or"),
    (MAPS | {"render.ray_rule": "maximum"}, "render.ray_rule must be"),
    (SAMPLED | {"pose.num_heads": 1}, "pose.num_heads must be above 1"),
]


@pytest.mark.parametrize(("changes", "says"), REFUSED)
def test_what_cannot_work_is_refused_by_name_before_anything_is_made(
    config, tmp_path, changes, says
):
    for field, value in changes.items():
        set_field(config, field, str(tmp_path) if value == "HERE" else value)
    error = refuse(config, tmp_path / "workdir")
    assert says in error and not (tmp_path / "workdir").exists()


def test_sets_that_do_not_fit_the_config_are_refused(config, monkeypatch):
    set_field(config, "pose.source", "given")
    made = make_dataset(models=4, views=5)._replace(quaternions=None)
    monkeypatch.setattr(setup, "load_or_render", lambda *_, **__: made)
    with pytest.raises(ValueError, match="the train and val and test images"):
        setup.load_sets(from_fields(config.to_dict()))
    set_field(config, "train.models_per_batch", 5)
    with pytest.raises(ValueError, match="= 5 models to train on, but there are 4"):
        setup.load_sets(from_fields(config.to_dict()))


def test_a_workdir_that_is_a_file_is_refused_and_the_file_is_left_alone(
    config, tmp_path
):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    for workdir in (path, path / "below"):
        assert "cannot be made or written" in refuse(config, workdir)
    assert path.read_text() == "mine"


def test_a_workdir_of_another_config_is_refused_naming_what_differs(config, tmp_path):
    workdir = claim_workdir(tmp_path / "workdir", from_fields(config.to_dict()))
    (workdir / "metrics.jsonl").write_text('{"step": 5, "seconds": 1}\n')
    before = (workdir / "config.json").read_text()
    config.train.steps = 21
    config.pose.num_heads = 3
    error = refuse(config, workdir)
    assert "pose.num_heads (2 there, 3 here), train.steps (20 there, 21 here)" in error
    assert (workdir / "config.json").read_text() == before


def test_a_workdir_in_use_is_refused_and_its_config_is_left_alone(config, tmp_path):
    claim_workdir(tmp_path, from_fields(config.to_dict()))
    before = (tmp_path / "config.json").read_bytes()
    config.train.learning_rate = 0.5
    with hold_workdir(tmp_path):
        assert "used by one command at a time" in refuse(config, tmp_path)
    assert (tmp_path / "config.json").read_bytes() == before
    # Of the one that used it nothing is left.
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_a_config_of_another_program_is_refused_and_left_alone(config, tmp_path):
    (tmp_path / "config.json").write_text('{"editor": "mine"}')
    assert "config must have no other fields" in refuse(config, tmp_path)
    assert (tmp_path / "config.json").read_text() == '{"editor": "mine"}'


def test_a_start_that_was_refused_leaves_its_workdir_to_a_better_one(config, tmp_path):
    workdir = claim_workdir(tmp_path / "workdir", from_fields(config.to_dict()))
    config.train.models_per_batch = 1
    assert claim_workdir(workdir, from_fields(config.to_dict())) == workdir


def test_what_does_not_change_the_result_may_differ(config, tmp_path):
    claim_workdir(tmp_path, from_fields(config.to_dict()))
    (tmp_path / "metrics.jsonl").touch()  # of a run that has begun
    changes = {
        "data.cache_dir": "elsewhere",
        "log.every": 3,
        "render.renders_at_once": 7,
        "run.devices": 1,
    }
    assert all(name.startswith(FREE_FIELDS) for name in changes)
    config.update_from_flattened_dict(changes)
    claim_workdir(tmp_path, from_fields(config.to_dict()))


# What the command line refuses before a config is there.


DEBUG = f"--config={FOLDER / 'debug.py'}"


# ml_collections 1.1 loads a config file by a method that Python has deprecated.
@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning:importlib")
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([DEBUG, "--config.train.stepz=3"], ["no field 'stepz'", "steps"]),
        ([DEBUG, "--config.trian.steps=3"], ["'trian'", '"train"']),
        ([DEBUG, "--config.train.steps=abc"], ["abc"]),
        ([DEBUG, "--wrkdir=x"], ["wrkdir"]),
        ([DEBUG, "car"], ["Expected only flags, but car was given"]),
        ([], ["arguments are required: --config"]),
        (["--config=configs/plane.py"], ["configs/plane.py"]),
        (["--config=bus"], ["bus"]),
        ([f"{DEBUG}:fast"], ["paper, naive, known_pose", "but it has fast;"]),
    ],
    ids=lambda arguments: " ".join(arguments).replace(DEBUG, "DEBUG"),
)
def test_a_command_line_that_says_nothing_is_refused(arguments, says):
    error = refuse_flags(arguments)
    assert "\n" not in error and "Traceback" not in error
    assert all(words in error for words in says)
