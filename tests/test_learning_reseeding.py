"""Points that hang alone in every shape begin anew at others; the rest stays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    assert_same_bits,
    make_batch,
    make_dataset,
    make_network,
    make_state,
    tiny_config,
)

from dpc_jax.config import replace_fields
from dpc_jax.evaluation.chamfer import count_stray_points
from dpc_jax.learning import devices
from dpc_jax.learning.predictions import encode_views
from dpc_jax.learning.step import describe_state
from dpc_jax.learning.training import loop, reseeding
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.learning.training.records import MetricLog

DEAD = 5  # index of a point


def make_clouds(lone, *, clouds=6, points=40):
    """Clouds [B, N, 3] of a small ball, in some of which point DEAD hangs alone."""
    rng = np.random.default_rng(0)
    found = 0.02 * rng.normal(size=(clouds, points, 3))
    found[:lone, DEAD] = [0.1, 0, 0.5]
    return found


@pytest.mark.parametrize("lone, dead", [(6, [DEAD]), (4, [DEAD]), (3, []), (0, [])])
def test_a_point_is_dead_that_hangs_alone_in_most_clouds(lone, dead):
    clouds = make_clouds(lone)
    assert sum(count_stray_points(cloud) for cloud in clouds) == lone
    shares = np.asarray(reseeding.measure_lone(jnp.array(clouds)))
    np.testing.assert_allclose(shares[DEAD], lone / len(clouds), rtol=1e-6)
    assert np.flatnonzero(shares > 0.5).tolist() == dead


def predict(state, batch, network):
    views = (batch[n].reshape(-1, *batch[n].shape[2:]) for n in ("images", "masks"))
    features = encode_views(state.params, *views, network=network)
    return network.apply(state.params, features, method="predict_shape")


def start(count=1, *, place=(2.0, 2.0, 2.0), **fields):
    """A state whose point DEAD is at a place of its own, and what belongs to it."""
    config = tiny_config(models_per_batch=4, pull_weight=0.03, **fields)
    config = replace_fields(config, {"run": {"devices": count}})
    network = make_network(config)
    state = make_state(network, config)
    layer = state.params["params"]["shape"]["points"]
    moved = layer["bias"].at[3 * DEAD : 3 * DEAD + 3].set(jnp.array(place))
    layer["bias"] = jax.device_put(moved, layer["bias"].sharding)
    # All others near the middle, wherever the first weights have them.
    near = 0.01 * layer["kernel"] / jnp.max(jnp.abs(layer["kernel"]))
    layer["kernel"] = jax.device_put(near, layer["kernel"].sharding)
    return state, network, config


def reseed(state, batches, network, config):
    return reseeding.reseed_points(state, batches, network=network, config=config)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"color_weight": 0.3, "colors_move_points": False},
        {"point_size": "covariance"},
    ],
    ids=["points", "colours", "covariances"],
)
def test_a_dead_point_is_as_another_one_and_the_rest_as_before(fields):
    state, network, config = start(**fields)
    batch = make_batch(models=4)
    before = jax.tree.map(np.asarray, predict(state, batch, network))
    moments = jax.tree.map(np.asarray, state.optimizer)
    state, count = reseed(state, [batch], network, config)
    after = jax.tree.map(np.asarray, predict(state, batch, network))
    assert count == 1
    others = np.arange(24) != DEAD
    per_point = {"points", "colors", "sizes", "turns"} & set(before)
    assert len(per_point) == 1 + len(fields.get("point_size", "")) // 5 + (
        "color_weight" in fields
    )
    twin = None
    for name in sorted(per_point, reverse=True):  # all of it is of one other point
        np.testing.assert_array_equal(after[name][:, others], before[name][:, others])
        away = np.abs(after[name][:, [DEAD]] - before[name]).max(axis=(0, 2))
        near = int(np.argmin(np.where(others, away, np.inf)))
        # Twins begin a little apart: 0.02 before a tanh that is halved.
        assert away[near] < (0.04 if name == "points" else 1e-6)
        twin = near if name != "points" and twin is None else twin
        assert name == "points" or near == twin
    assert np.abs(after["points"][:, DEAD]).max() < 0.4
    assert_same_bits(jax.tree.leaves(moments)[0], jax.tree.leaves(state.optimizer)[0])


def test_where_no_point_hangs_alone_nothing_changes():
    state, network, config = start(place=(0.0, 0.0, 0.0))
    before = jax.tree.map(np.array, state)
    state, count = reseed(state, [make_batch(models=4)], network, config)
    assert count == 0
    assert_same_bits(before, state)


def test_on_four_devices_the_same_points_begin_anew(monkeypatch):
    monkeypatch.setattr(devices, "SHARED_WEIGHTS", 100)  # as those of a large network
    found = []
    for count in (1, 4):
        state, network, config = start(count)
        kernel = state.params["params"]["shape"]["points"]["kernel"]
        place = kernel.sharding
        assert (count == 1) == kernel.is_fully_replicated
        batches = [make_batch(models=4, seed=seed) for seed in range(2)]
        state, new = reseed(state, batches, network, config)
        assert new == 1
        kernel = state.params["params"]["shape"]["points"]["kernel"]
        assert kernel.sharding == place
        found.append(np.asarray(kernel))
    np.testing.assert_allclose(*found, rtol=1e-6, atol=1e-7)


def test_a_run_ends_without_points_that_hang_alone(tmp_path):
    """The last checkpoint is of the state that is validated and returned."""
    state, network, config = start(steps=3, learning_rate=1e-6, keep_levels=1)
    seen = []
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    outcome = loop.train(
        state,
        make_dataset(models=6),
        network=network,
        config=config,
        checkpoints=checkpoints,
        log=MetricLog(tmp_path / "metrics.jsonl"),
        evaluate=lambda state: seen.append(jax.tree.map(np.array, state)) or {},
    )
    shape = predict(outcome.state, make_batch(models=4), network)
    lone = [count_stray_points(cloud) for cloud in np.asarray(shape["points"])]
    assert max(lone) == 0
    assert_same_bits(seen[-1], outcome.state)
    saved = checkpoints.restore(describe_state(network, config)).state
    checkpoints.close()
    assert_same_bits(saved, outcome.state)
