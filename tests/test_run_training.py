"""A run that begins with the parameters of another one; memory of the device."""

import os
import shutil
from types import SimpleNamespace

import jax
import pytest
from tiny_runs import assert_same_bits, make_network, tiny_config, write_workdir

from dpc_jax.learning.step import init_state
from dpc_jax.run.pipeline import begin_run, check_memory

CONFIG = tiny_config()


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Workdir of a run of another seed and more steps, and its state at step 7."""
    folder = tmp_path_factory.mktemp("runs") / "first"
    config = tiny_config(steps=40, seed=5)
    state = init_state(make_network(config), config)
    optimizer = jax.tree.map(lambda a: a + 1, state.optimizer)
    last = state._replace(step=state.step + 7, optimizer=optimizer)
    return write_workdir(folder, config, state=last), last


@pytest.fixture
def workdir(saved):
    return saved[0]


def begin(workdir, **changes):
    config = tiny_config(init_from=str(workdir), **changes)
    return begin_run(make_network(config), config)


def test_parameters_are_the_other_runs_and_all_else_begins_anew(saved, capsys):
    workdir, last = saved
    state = begin(workdir)
    first = init_state(make_network(CONFIG), CONFIG)
    assert_same_bits(state.params, last.params)
    assert_same_bits(state._replace(params=first.params), first)
    said = capsys.readouterr().out
    assert said == f"Beginning with the parameters of {workdir}, step 7.\n"


def test_a_run_of_other_sizes_is_refused_by_the_fields_that_differ(workdir):
    with pytest.raises(ValueError) as caught:
        colors = {"color_weight": 0.3, "colors_move_points": False}
        begin(workdir, shape_hidden=10, num_points=20, learning_rate=0.5, **colors)
    said = str(caught.value)
    assert "network.shape_hidden (12 there, 10 here)" in said
    assert "render.num_points (24 there, 20 here)" in said
    assert "train.colors_move_points (True there, False here)" in said
    assert "learning_rate" not in said and "steps" not in said
    assert said.endswith("(--config.SECTION.FIELD=VALUE).")


@pytest.mark.parametrize("missing", ["config.json", "checkpoints", "inside", "bytes"])
def test_a_folder_without_a_run_is_refused_in_a_sentence(workdir, tmp_path, missing):
    if missing != "config.json":
        text = (workdir / "config.json").read_text()
        (tmp_path / "config.json").write_text(text)
    if missing == "inside":
        (tmp_path / "checkpoints").mkdir()
    if missing == "bytes":
        shutil.copytree(workdir / "checkpoints", tmp_path / "checkpoints")
        for path in (tmp_path / "checkpoints").rglob("*"):
            if path.is_file():
                os.truncate(path, path.stat().st_size // 2)
    with pytest.raises(ValueError, match=r"^Expected .*; give the .*workdir.*\.$"):
        begin(tmp_path)
    assert not list(tmp_path.rglob("*.tmp"))


MB = 2**20


def compile_copies(count):
    """A program that holds its megabyte of input and `count` more of output."""
    vector = jax.ShapeDtypeStruct((MB // 4,), "float32")
    return jax.jit(lambda x: [x + i for i in range(count)]).lower(vector).compile()


def test_a_program_that_needs_more_than_the_device_has_is_refused(monkeypatch):
    check_memory(compile_copies(8))  # a CPU does not tell its memory
    stats = {"bytes_limit": 4 * MB}
    device = SimpleNamespace(memory_stats=lambda: stats)
    monkeypatch.setattr(jax, "local_devices", lambda: [device])
    check_memory(compile_copies(2))
    with pytest.raises(ValueError, match="fit into the device.s memory") as refused:
        check_memory(compile_copies(8))
    assert "renders_at_once=4" in str(refused.value)
    assert "models_per_batch lower" in str(refused.value)
