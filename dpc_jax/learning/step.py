"""The training step: a pure function of state and batch, compiled once per stage."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.config import Config, Train
from dpc_jax.learning import schedules
from dpc_jax.learning.objective import compute_loss
from dpc_jax.networks import ShapePoseNetwork


class TrainState(NamedTuple):
    """All that a checkpoint holds.

    Attributes:
      step: () int32, steps done.
      params: of the network.
      optimizer: state of the optimiser.
      covariance: [3, 3] of predicted points, averaged over the last hundred or so
        batches: its principal axes are those of the half turns.
    """

    step: jax.Array
    params: optax.Params
    optimizer: optax.OptState
    covariance: jax.Array


def make_optimizer(train: Train) -> optax.GradientTransformation:
    """Adam with the run's learning rate; AdamW where weight decay is asked for."""
    rate = schedules.make_learning_rate(train)
    if train.weight_decay:
        return optax.adamw(rate, weight_decay=train.weight_decay)
    return optax.adam(rate)


def init_state(network: ShapePoseNetwork, config: Config) -> TrainState:
    """Parameters and optimiser at step 0, from the seed alone."""
    size = config.data.image_size
    images = jnp.zeros((1, size, size, 3))
    params = jax.jit(network.init)(jax.random.key(config.seed), images)
    optimizer = make_optimizer(config.train).init(params)
    return TrainState(jnp.asarray(0, jnp.int32), params, optimizer, jnp.zeros((3, 3)))


def make_train_step(
    network: ShapePoseNetwork, config: Config, stage: schedules.Stage
) -> Callable:
    """The compiled step of a stage.

    Returns:
      A function (state, batch) -> (state, metrics) that gives the old state's memory
      to the new one. The dropout key is a function of seed and step, so any step can
      be replayed.
    """
    optimizer = make_optimizer(config.train)

    def step(state: TrainState, batch):
        key = jax.random.fold_in(jax.random.key(config.seed), state.step)
        (loss, (metrics, covariance)), grads = jax.value_and_grad(
            compute_loss, has_aux=True
        )(
            state.params,
            batch,
            key,
            state.step,
            state.covariance,
            network=network,
            render=config.render,
            pose=config.pose,
            train=config.train,
            stage=stage,
        )
        updates, opt_state = optimizer.update(grads, state.optimizer, state.params)
        params = optax.apply_updates(state.params, updates)
        metrics["loss"] = loss
        metrics["gradient_norms"] = {
            name: optax.tree.norm(part) for name, part in grads["params"].items()
        }
        return TrainState(state.step + 1, params, opt_state, covariance), metrics

    return jax.jit(step, donate_argnums=0)
