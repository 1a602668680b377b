"""Several short starts: the best one goes on, as a run of its own would have begun."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import assert_same_bits, make_dataset, make_network, tiny_config

from dpc_jax.config import check
from dpc_jax.learning.step import init_state
from dpc_jax.learning.training import loop, starts
from dpc_jax.learning.training.starts import find_start

CONFIG = tiny_config(steps=8, starts=3, start_steps=4)  # the first of two stages
NETWORK = make_network(CONFIG)
DATASET = make_dataset()

pytestmark = pytest.mark.usefixtures("quickly")
_compile = functools.lru_cache(loop.make_train_step)


@pytest.fixture(autouse=True)
def share_compiled_steps(monkeypatch):
    """All starts of this file use one program; its gradients are measured each step."""
    monkeypatch.setattr(
        loop,
        "make_train_step",
        lambda network, config, stage: _compile(network, CONFIG, stage),
    )


def make_first(index=0):
    seed = CONFIG.seed + index * starts._SEEDS_APART
    return init_state(NETWORK, dataclasses.replace(CONFIG, seed=seed))


def find(**changes):
    return find_start(make_first(), DATASET, network=NETWORK, config=CONFIG, **changes)


def train_alone(index):
    """A start by the plainest loop: its last state and its losses."""
    state, losses = make_first(index), []
    stage = loop.schedules.find_stage(0, CONFIG.render, steps=CONFIG.train.steps)
    step = _compile(NETWORK, CONFIG, stage)
    for done in range(CONFIG.train.start_steps):
        batch = loop.make_batch(DATASET, done, CONFIG)
        state, metrics = step(state, batch)
        losses.append(float(metrics["reprojection"]))
    return state, losses


def test_the_start_of_the_least_loss_goes_on_where_it_ended():
    lines = []
    found = find(tell=lines.append)
    alone = [train_alone(index) for index in range(3)]
    late = [np.mean(losses[2:]) for _, losses in alone]
    assert np.allclose(found.losses, late, rtol=1e-5)  # of float32
    assert found.index == int(np.argmin(late)) and len(set(late)) == 3
    assert int(found.state.step) == 4
    assert_same_bits(found.state.params, alone[found.index][0].params)
    assert [record["step"] for record in found.records] == [1, 2, 3, 4]
    assert f"Start {found.index + 1} goes on" in lines[0]
    assert found.seconds > 0


def test_a_start_that_is_told_to_stop_gives_nothing():
    assert find(should_stop=lambda: True) is None


@pytest.mark.parametrize("best", [0, 1, 2])
def test_whichever_start_is_best_is_taken(best, monkeypatch):
    order = iter([{best: 1.0}.get(index, 2.0) for index in range(3)])

    def train(state, *_, log, until, **__):
        loss = next(order)
        for step in range(1, until + 1):
            log.write({"step": step, "reprojection": loss})
        return loop.Outcome(state._replace(step=jnp.array(until)), 1.0, True)

    monkeypatch.setattr(loop, "train", train)
    found = find(tell=lambda _: None)
    assert found.index == best
    assert_same_bits(found.state.params, make_first(best).params)
    assert jax.tree.structure(found.state) == jax.tree.structure(make_first())


def test_starts_as_long_as_the_run_are_refused():
    check(CONFIG)
    train = dataclasses.replace(CONFIG.train, start_steps=8)
    with pytest.raises(ValueError, match="start_steps must be below train.steps = 8"):
        check(dataclasses.replace(CONFIG, train=train))
