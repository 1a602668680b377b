"""The loop: what is logged, saved and timed, and how it breaks.

That a run ends alike whatever stops it on the way: tests/test_main_pipeline.py.
"""

import dataclasses
import functools
import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import copy, make_dataset, make_network, make_state, tiny_config

from dpc_jax.config import Log
from dpc_jax.learning.training import loop
from dpc_jax.learning.training import records as recording
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.learning.training.records import MetricLog, NonFiniteError

CONFIG = tiny_config(steps=8)  # two stages of four steps
NETWORK = make_network(CONFIG)
DATASET = make_dataset()
SCORES = {"pose_accuracy": 0.5, "pose_median_error_deg": 45.0, "chamfer": 7.0}


_compile = functools.lru_cache(loop.make_train_step)


def compile_once(network, config, stage):
    """The step of a stage, whose gradients are measured as for a log of every step."""
    return _compile(network, dataclasses.replace(config, log=CONFIG.log), stage)


@pytest.fixture(autouse=True)
def share_compiled_steps(monkeypatch):
    """All loops of this file use the same two programs; compiling takes seconds."""
    monkeypatch.setattr(loop, "make_train_step", compile_once)


@pytest.fixture(scope="module")
def first_state():
    return make_state(NETWORK, CONFIG)


def run_loop(folder, state, *, every=(1, 0, 2), **changes):
    checkpoints = Checkpoints(folder / "checkpoints")
    log = MetricLog(folder / "metrics.jsonl")
    changes["config"] = dataclasses.replace(CONFIG, log=Log(*every))
    given = {"dataset": DATASET, "network": NETWORK, "log": log}
    given |= {"evaluate": lambda state: SCORES, "checkpoints": checkpoints} | changes
    try:
        return loop.train(copy(state), **given)
    finally:
        checkpoints.close()


def restore(folder, state):
    checkpoints = Checkpoints(folder / "checkpoints")
    restored = checkpoints.restore(state)
    steps = checkpoints.steps()
    checkpoints.close()
    return restored, steps


def read(folder):
    return MetricLog(folder / "metrics.jsonl").read()


def test_log_validation_and_checkpoints_come_at_their_intervals_and_at_the_end(
    tmp_path, first_state
):
    seen = []

    def evaluate(state):
        seen.append(int(state.step))
        return SCORES

    run_loop(tmp_path, first_state, every=(3, 5, 7), evaluate=evaluate)
    records = read(tmp_path)
    assert [r["step"] for r in records if "loss" in r] == [3, 6, 8]
    assert [r["step"] for r in records if "chamfer" in r] == [5, 8] == seen
    assert sum(records[0]["head_shares"]) == pytest.approx(1, abs=1e-3)
    assert {"reprojection", "student", "gradient_norm_pose"} <= records[0].keys()
    assert restore(tmp_path, first_state)[1] == [7, 8]


def test_a_validation_soon_before_the_last_one_is_left_out(tmp_path, first_state):
    run_loop(tmp_path, first_state, every=(3, 7, 0))
    assert [r["step"] for r in read(tmp_path) if "chamfer" in r] == [8]


def test_the_time_of_a_validation_is_not_training_time(
    tmp_path, first_state, monkeypatch
):
    # A clock that only the validation moves.
    now = [0.0]
    monkeypatch.setattr(recording.time, "monotonic", lambda: now[0])

    def evaluate(state):
        now[0] += 500.0
        return SCORES

    # Of the run before it took 70 seconds.
    outcome = run_loop(
        tmp_path, first_state, every=(4, 4, 4), evaluate=evaluate, seconds=70.0
    )
    assert now[0] == 1000.0
    assert [r["seconds"] for r in read(tmp_path)] == [70, 70, 70, 70]
    assert outcome.seconds == restore(tmp_path, first_state)[0].seconds == 70


def test_lines_say_that_a_program_compiles_and_how_far_a_run_is(
    tmp_path, first_state, capsys
):
    run_loop(tmp_path, first_state, every=(6, 0, 0), title="Training car")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "Training car: compiling"
    assert re.fullmatch(r"Training car: compiling took \d+\.\d s", lines[1])
    report = r".* step (\d)/8, loss [\d.]+, [\d.]+ steps/s, (\d+) s of training left"
    found = [re.fullmatch(report, line) for line in lines]
    assert [f[1] for f in found if f] == ["6", "8"]
    assert found[-2][2] == "0" and lines[-1].startswith("Validation at step 8: ")


def break_shape(program, state, batch):
    """The step from a state of which one parameter is not finite."""

    def spoil(path, leaf):
        is_scale = {"shape", "scale"} <= {key.key for key in path}
        return jnp.full_like(leaf, jnp.nan) if is_scale else leaf

    params = jax.tree_util.tree_map_with_path(spoil, state.params)
    return program(state._replace(params=params), batch)


def grow_loss(program, state, batch):
    state, metrics = program(state, batch)
    return state, metrics | {"loss": metrics["loss"] * 1e3}


@pytest.mark.parametrize(
    ("take_step", "sentence", "every"),
    [
        (break_shape, "reprojection loss became nan at step 5", (100, 0, 1)),
        (grow_loss, r"diverged: the loss grew from .* step 5", (1, 0, 2)),
    ],
)
def test_a_run_that_breaks_ends_with_its_step_at_the_last_good_checkpoint(
    tmp_path, first_state, monkeypatch, take_step, sentence, every
):
    def make_bad_step(network, config, stage):
        step = compile_once(network, config, stage)

        def run(program, state, batch):
            is_due = int(state.step) == 5
            return (take_step if is_due else call)(program, state, batch)

        def lower(*structs):
            program = step.lower(*structs).compile()
            return SimpleNamespace(compile=lambda: functools.partial(run, program))

        return SimpleNamespace(lower=lower)

    def call(program, state, batch):
        return program(state, batch)

    monkeypatch.setattr(loop, "make_train_step", make_bad_step)
    # The NaN is meant, so JAX_DEBUG_NANS must not stop it first.
    with jax.debug_nans(False), pytest.raises(NonFiniteError, match=sentence):
        run_loop(tmp_path, first_state, every=every)
    restored, steps = restore(tmp_path, first_state)
    last = 5 if every[2] == 1 else 4
    assert steps[-1] == int(restored.state.step) == last
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(restored.state))
    assert all(np.isfinite(r["loss"]) for r in read(tmp_path) if "loss" in r)
