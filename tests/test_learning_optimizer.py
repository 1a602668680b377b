"""The learning rate, Muon, and the penalty on weights."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from tiny_runs import tiny_config

from dpc_jax.learning.optimizer import (
    find_penalized,
    make_learning_rate,
    make_optimizer,
    orthogonalize,
)


def rates(*steps, **changes):
    schedule = make_learning_rate(tiny_config(**changes).train)
    return [float(schedule(step)) for step in steps]


def test_the_learning_rate_warms_up_and_decays_as_a_cosine():
    found = rates(
        *(0, 1, 200, 700, 1200, 2000),
        **dict(steps=1200, learning_rate=1e-2, optimizer="muon"),
    )
    # The first step already moves, by 1 / 200 of the peak. The line of the warm-up
    # reaches the peak at step 200.
    second = 5e-5 + 1e-2 * 0.995 / 200
    expected = [5e-5, second, 1e-2, 1e-2 * 1.02 / 2, 2e-4, 2e-4]
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("steps", [1, 4, 20])
def test_the_warm_up_of_a_short_run_takes_a_fifth_of_it(steps):
    found = rates(*range(steps), steps=steps, optimizer="muon", learning_rate=1e-3)
    assert found[steps // 5] == max(found) == pytest.approx(1e-3, rel=1e-5)


@pytest.mark.parametrize("shape", [(3, 3, 8, 16), (1, 1, 4, 16), (5, 5, 4, 1)])
@pytest.mark.parametrize("norm", [1e-30, 1.0, 1e30])
def test_orthogonalized_kernels_keep_their_directions_at_one_size(shape, norm):
    kernel = np.random.default_rng(0).normal(size=shape)
    found = jax.jit(orthogonalize)(jnp.asarray(norm * kernel, jnp.float32))
    assert found.shape == shape
    found = np.asarray(found, np.float64).reshape(-1, shape[-1])
    left, _, right = np.linalg.svd(kernel.reshape(found.shape), False)
    inside = left.T @ found @ right.T
    sizes = np.diag(inside) / (0.6 * max(found.shape) ** 0.5)
    # The polynomial's own range; float32 rounds to about 1e-5 of it.
    assert 0.65 < sizes.min() and sizes.max() < 1.25
    np.testing.assert_allclose(inside, np.diag(np.diag(inside)), atol=1e-4)


def test_kernels_of_zeros_and_of_one_direction_stay_so():
    assert not orthogonalize(jnp.zeros((3, 3, 2, 4))).any()
    one = jnp.outer(jnp.arange(1.0, 19), jnp.arange(4.0)).reshape(3, 3, 2, 4)
    found = np.asarray(orthogonalize(one)).reshape(18, 4)
    sizes = np.linalg.svd(found, compute_uv=False)
    assert sizes[1] < 1e-3 * sizes[0]


def test_muon_moves_the_convolutions_of_the_encoder_and_adam_all_else():
    rng = np.random.default_rng(0)
    layers = {"Conv_0": {"kernel": rng.normal(size=(3, 3, 2, 4)), "bias": np.ones(4)}}
    params = jax.tree.map(jnp.float32, {"params": dict(encoder=layers, shape=layers)})
    train = tiny_config(optimizer="muon").train
    optimizer, adam = make_optimizer(train), optax.adam(make_learning_rate(train))
    state, plain = optimizer.init(params), adam.init(params)
    momentum = 0
    for step in range(3):
        gradient = jax.tree.map(lambda p, s=step: jnp.cos((s + 1) * p), params)
        found, state = optimizer.update(gradient, state, params)
        expected, plain = adam.update(gradient, plain, params)
        own = gradient["params"]["encoder"]["Conv_0"]["kernel"]
        momentum = own + 0.95 * momentum  # and once more: Nesterov's
        moved = orthogonalize(own + 0.95 * momentum)
        expected["params"]["encoder"]["Conv_0"]["kernel"] = (
            -make_learning_rate(train)(step) * moved
        )
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-8),
            *(found, expected),
        )


def test_the_penalty_is_half_the_squared_weights_in_the_loss_before_adam():
    """Of weights of encoder and shape only."""
    rng = np.random.default_rng(0)
    leaves = ("kernel", "bias")
    params = {
        "params": {
            name: {leaf: jnp.asarray(rng.normal(size=3)) for leaf in leaves}
            for name in ("encoder", "shape", "pose")
        }
    }
    chosen = find_penalized(params)
    assert chosen["params"] == {
        name: {"kernel": name != "pose", "bias": False} for name in params["params"]
    }

    plain, ours = (
        make_optimizer(tiny_config(l2_weight=weight).train) for weight in (0.0, 0.01)
    )
    gradient = jax.tree.map(jnp.cos, params)
    whole = jax.tree.map(lambda g, a, on: g + 0.01 * a * on, gradient, params, chosen)
    expected, _ = plain.update(whole, plain.init(params), params)
    found, _ = ours.update(gradient, ours.init(params), params)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), found, expected
    )
