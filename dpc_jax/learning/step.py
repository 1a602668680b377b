"""The training step: a pure function of state and batch, compiled once per stage."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import NamedSharding

from dpc_jax.config import Config
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.objective import compute_loss
from dpc_jax.learning.optimizer import make_optimizer
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.networks import ShapePoseNetwork


class TrainState(NamedTuple):
    """All that a checkpoint holds.

    Attributes:
      step: () int32, steps done.
      params: of the network.
      optimizer: state of the optimiser.
      averages: over the batches before.
    """

    step: jax.Array
    params: optax.Params
    optimizer: optax.OptState
    averages: Averages


def init_state(network: ShapePoseNetwork, config: Config) -> TrainState:
    """Parameters and optimiser at step 0, from the seed alone, on the run's devices."""
    like = describe_state(network, config)
    # One program, in which the seed is an input: runs with other seeds share it.
    init = jax.jit(
        lambda seed: _init_whole(network, config, seed),
        out_shardings=jax.tree.map(lambda leaf: leaf.sharding, like),
    )
    return init(np.uint32(config.seed))


def describe_state(network: ShapePoseNetwork, config: Config) -> TrainState:
    """Shapes, dtypes and places of a state's arrays, as `jax.ShapeDtypeStruct`.

    What was seen of the category is whole: every device judges its objects by it.
    """
    mesh = devices.make_mesh(config)
    shapes = jax.eval_shape(lambda: _init_whole(network, config, 0))
    whole = jax.tree.map(lambda _: devices.WHOLE, shapes)
    params, optimizer = devices.choose_parts((shapes.params, shapes.optimizer), mesh)
    return jax.tree.map(
        lambda leaf, part: jax.ShapeDtypeStruct(
            leaf.shape, leaf.dtype, sharding=NamedSharding(mesh, part)
        ),
        shapes,
        whole._replace(params=params, optimizer=optimizer),
    )


def find_parts(network: ShapePoseNetwork, config: Config) -> TrainState:
    """The partition of each array of a state."""
    return jax.tree.map(lambda a: a.sharding.spec, describe_state(network, config))


def _init_whole(network, config, seed):
    size = config.data.image_size
    params = network.init(
        jax.random.key(seed), jnp.zeros((1, size, size, network.inputs))
    )
    optimizer = make_optimizer(config.train).init(params)
    cost = jnp.zeros(()) if config.pose.source == "sampled" else None
    frame, pose = None, config.pose
    if pose.common_frame and pose.half_turns and config.network.shape == "points":
        if pose.common_frame == "colors":  # each loaded where asked for
            from dpc_jax.learning.choice.colors import start_counts

            frame = start_counts()
        else:
            from dpc_jax.learning.choice.common_frame import start_frame

            frame = start_frame(pose.turns)
    step = jnp.asarray(0, jnp.int32)
    averages = Averages(jnp.zeros((3, 3)), cost, frame)
    return TrainState(step, params, optimizer, averages)


def make_train_step(
    network: ShapePoseNetwork, config: Config, stage: schedules.Stage
) -> Callable:
    """The compiled step of a stage, over all devices of the run.

    Returns:
      A function (state, batch) -> (state, metrics) that gives the old state's memory
      to the new one. The dropout key is a function of seed, step and place in the
      batch, so any step can be replayed, on any number of devices. The batch has
      "view_ids" int32 [B, V] and "seeds" uint32 [B] besides the arrays of `read_batch`,
      the run's seed for each object: as an input, so that other seeds share the
      program.
      The metrics are those of `compute_loss`, the loss, and "gradient_norms" {module:
      ()}, measured at one step of ten (`devices.compute_norms`).
    """
    mesh = devices.make_mesh(config)
    parts = find_parts(network, config)
    update = _make_update(network, config, stage, parts, mesh.size)
    shared = jax.shard_map(
        update,
        mesh=mesh,
        in_specs=(parts, devices.OBJECTS),
        out_specs=(parts, devices.WHOLE),
        check_vma=False,
    )
    return jax.jit(shared, donate_argnums=0)


def _make_update(network, config, stage, parts, num_devices):
    """The step of one device, with its share of the batch."""
    optimizer = make_optimizer(config.train)
    sections = config.render, config.pose, config.train
    recipe = Recipe(network, *sections, config.spreads_masks)
    # Some steps of every record, and its last.
    cadence = math.gcd(10, config.log.every)

    def compute_share(params, batch, keys, state):
        """This device's part of the loss, which is a mean over all objects."""
        with devices.sharing_columns():
            loss, aux = compute_loss(
                params,
                batch,
                keys,
                state.step,
                state.averages,
                recipe=recipe,
                stage=stage,
            )
        return loss / num_devices, aux

    def update(state, batch):
        key = jax.random.fold_in(jax.random.key(batch["seeds"][0]), state.step)
        # An object has its own key, whichever device it is on.
        keys = devices.take_own(jax.random.split(key, config.train.models_per_batch))
        (loss, (metrics, averages)), grads = jax.value_and_grad(
            compute_share, has_aux=True
        )(state.params, batch, keys, state)
        winners = metrics.pop("winners", {})
        metrics = {name: value / num_devices for name, value in metrics.items()}
        metrics["loss"] = loss
        grads, metrics = devices.sum_whole(
            (grads, metrics), (parts.params, dict.fromkeys(metrics, devices.WHOLE))
        )
        updates, opt_state = optimizer.update(grads, state.optimizer, state.params)
        params = optax.apply_updates(state.params, updates)
        if recipe.pose.learned_heads:
            metrics["winners"] = jax.lax.all_gather(winners, devices.AXIS, tiled=True)
        metrics["gradient_norms"] = devices.compute_norms(
            grads["params"],
            parts.params["params"],
            (state.step + 1) % cadence == 0,
        )
        new = TrainState(state.step + 1, params, opt_state, averages)
        return new, metrics

    return update
