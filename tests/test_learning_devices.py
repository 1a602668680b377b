"""The training step over several devices: the same learning, shared."""

import contextlib
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import PartitionSpec
from tiny_runs import (
    assert_same_bits,
    copy,
    make_batch,
    make_dataset,
    make_network,
    make_state,
    make_step,
    tiny_config,
)

from dpc_jax.config import check
from dpc_jax.learning import devices
from dpc_jax.learning.inference import predictor as predictor_module
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.training.checkpoints import Checkpoints

# Half turns, a common frame, dropout, a selecting student and priors: all that objects
# could share.
EVERYTHING = dict(
    models_per_batch=4,
    flips=True,
    common_frame="colors",
    student="selects",
    repulsion_weight=0.1,
    containment_weight=1.0,
    learning_rate=3e-4,
)


@pytest.fixture(autouse=True, scope="module")
def shared_layers():
    """Weights of the tiny network are shared as those of a large one are."""
    patch = pytest.MonkeyPatch()
    patch.setattr(devices, "SHARED_WEIGHTS", 100)
    yield
    patch.undo()


def configure(count, **changes):
    return tiny_config(devices=count, **EVERYTHING | changes)


@functools.cache
def compile_step(count):
    """The config, the network's first state on the host, and the compiled step."""
    config = configure(count)
    network = make_network(config)
    return config, make_state(network, config), make_step(network, config)


def train(count, seeds=range(6)):
    """The loss of each step, one with each seed's batch; the states; last metrics."""
    _, state, step = compile_step(count)
    state = jax.tree.map(lambda a: jax.device_put(np.asarray(a), a.sharding), state)
    losses, states = [], []
    for seed in seeds:
        state, metrics = step(copy(state), make_batch(models=4, seed=seed))
        losses.append(float(metrics["loss"]))
        states.append(state)
    return np.array(losses), states, metrics


@pytest.fixture(scope="module")
def alone():
    return train(1)


def test_several_devices_give_the_loss_of_one(alone):
    losses, states, metrics = train(4)
    # The sums are the same in another order: six steps of rounding in float32.
    np.testing.assert_allclose(losses, alone[0], rtol=3e-5)
    np.testing.assert_array_equal(metrics["winners"], alone[2]["winners"])
    for name, norm in alone[2]["gradient_norms"].items():
        found = float(metrics["gradient_norms"][name])
        assert found == pytest.approx(float(norm), rel=1e-3)
    # One step of Adam moves every parameter by the learning rate, whatever the size of
    # its gradient; where that is rounding alone, so is the sign.
    first = map(jax.tree.leaves, (alone[1][0], states[0]))
    for one, other in zip(*first, strict=True):
        differs = np.abs(np.asarray(one) - np.asarray(other)) > 1e-6
        assert np.mean(differs) < 0.01


@pytest.mark.parametrize("bad", [None, "kernel", "bias"])
def test_gradients_are_measured_when_asked_and_else_looked_at(bad):
    mesh = devices.make_mesh(configure(2))
    trees = {"a": {"kernel": np.full((3, 4), 2.0), "bias": np.full(4, -1.0)}}
    if bad:
        trees["a"][bad].flat[1] = np.inf
    parts = {"a": {"kernel": devices.COLUMNS, "bias": devices.WHOLE}}
    norms = jax.shard_map(
        lambda trees, flag: devices.compute_norms(trees, parts, flag),
        mesh=mesh,
        in_specs=(parts, devices.WHOLE),
        out_specs=devices.WHOLE,
        check_vma=False,
    )
    measured = jax.jit(lambda flag: norms(trees, flag)["a"])
    # 12 squares of 2 and 4 of 1
    assert float(measured(True)) == pytest.approx(np.inf if bad else np.sqrt(52))
    # Between the measured steps a layer's biases tell whether it is finite.
    expected = np.nan if bad == "bias" else -1
    assert float(measured(False)) == pytest.approx(expected, nan_ok=True)


def test_volumes_are_learned_on_two_devices_as_on_one():
    found = []
    for count in (1, 2):
        config = tiny_config(shape="voxels", source="given", devices=count)
        network = make_network(config)
        state, metrics = make_step(network, config)(
            make_state(network, config), make_batch()
        )
        parts = jax.tree.leaves(state.params["params"]["shape"])
        assert any(not part.is_fully_replicated for part in parts) == (count == 2)
        found.append(jax.tree.map(np.asarray, (metrics["loss"], parts)))
    (one, first), (two, second) = found
    np.testing.assert_allclose(two, one, rtol=1e-5)
    for a, b in zip(first, second, strict=True):
        # A step of Adam is 1e-3; sums over two devices differ in the last digits.
        np.testing.assert_allclose(a, b, atol=1e-4)


def test_large_layers_and_their_moments_are_shared_by_columns():
    _, state, _ = compile_step(4)
    kernel = state.params["params"]["shape"]["points"]["kernel"]
    assert kernel.sharding.spec == PartitionSpec(None, "objects")
    assert kernel.addressable_shards[0].data.shape == (12, kernel.shape[1] // 4)
    moments = [
        leaf for leaf in jax.tree.leaves(state.optimizer) if leaf.shape == kernel.shape
    ]
    assert len(moments) == 2
    assert all(moment.sharding == kernel.sharding for moment in moments)


def test_a_run_goes_on_with_another_number_of_devices(alone, tmp_path):
    """With the same number to the same bits."""
    losses, states, _ = train(4)
    with contextlib.closing(Checkpoints(tmp_path)) as checkpoints:
        checkpoints.save(states[2], seconds=1.0)
        for count in (1, 4):
            _, state, step = compile_step(count)
            resumed = checkpoints.restore(state).state
            assert_same_bits(resumed, states[2])
            for seed in (3, 4, 5):
                resumed, metrics = step(resumed, make_batch(models=4, seed=seed))
            assert float(metrics["loss"]) == pytest.approx(losses[-1], rel=3e-5)
            if count == 4:
                assert_same_bits(resumed, states[-1])


def test_views_are_predicted_on_all_devices_as_on_one(alone, monkeypatch):
    monkeypatch.setattr(predictor_module, "VIEWS_AT_ONCE", 7)
    dataset = make_dataset(models=3, views=3)
    found = []
    for count in (1, 4):  # nine views, seven at once: neither fits four devices
        config, state, _ = compile_step(count)
        covariance = np.asarray(alone[1][-1].averages.covariance)
        averages = state.averages._replace(covariance=covariance)
        state = state._replace(averages=averages)
        predictor = make_predictor(make_network(config), config)
        found.append(predict_all(predictor, state, dataset))
    one, four = found
    np.testing.assert_array_equal(one.winners, four.winners)
    for name in ("points", "poses", "silhouettes"):
        np.testing.assert_allclose(
            getattr(one, name), getattr(four, name), atol=1e-5, err_msg=name
        )


def test_devices_that_cannot_share_a_batch_alike_or_are_not_there_are_refused():
    for asked in (3, 8):
        with pytest.raises(ValueError, match="run.devices must be 0, or a divisor of"):
            check(configure(asked))
    with pytest.raises(ValueError, match="at most 4, the devices that jax has, but it"):
        devices.make_mesh(configure(8, models_per_batch=8))


@pytest.mark.parametrize(
    "objects, cores, share", [(4, 2, 2), (4, 3, 2), (4, 64, 4), (5, 4, 1), (6, 4, 3)]
)
def test_by_default_as_many_devices_share_as_divide_the_objects(objects, cores, share):
    assert devices.find_share(objects, cores) == share


def test_whole_weights_stay_whole_where_columns_do_not_divide():
    mesh = devices.make_mesh(configure(4))
    tree = {"even": jnp.zeros((50, 8)), "odd": jnp.zeros((50, 7)), "bias": jnp.zeros(8)}
    parts = devices.choose_parts(tree, mesh)
    assert parts["even"] == devices.COLUMNS
    assert parts["odd"] == parts["bias"] == devices.WHOLE
