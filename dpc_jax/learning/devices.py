"""One training step over several devices: what each of them holds and computes.

The objects of a batch are shared out. So are the columns of the largest dense layers
(tensor parallelism, Shoeybi et al., 2019): their weights are read and updated once in
all and their gradients never leave a device; what travels are the few rows of a batch.
All other parameters are whole on every device, and their gradients are summed.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from dpc_jax.config import Config

AXIS = "objects"  # of the devices, inside `shard_map`
WHOLE, OBJECTS, COLUMNS = (PartitionSpec(*p) for p in ((), (AXIS,), (None, AXIS)))
# Layers with this many weights are shared. For smaller ones the exchange takes as long
# as it saves.
SHARED_WEIGHTS = 2**17
# Between processes, where an exchange takes about a millisecond, fewer layers pay.
SHARED_BETWEEN_PROCESSES = 2**20


def make_mesh(config: Config) -> Mesh:
    """The devices of a run, in a line.

    With `run.devices` 0 there are as many as divide the objects of a batch. All
    processes of a job have the same number.

    Raises:
      ValueError: where there are fewer devices than asked for, or the processes cannot
        share the objects alike.
    """
    asked, objects = config.run.devices, config.train.models_per_batch
    processes = jax.process_count()
    local = [jax.local_devices(process) for process in range(processes)]
    there = min(len(found) for found in local)
    if objects % processes:
        raise ValueError(
            f"config.train.models_per_batch must be a multiple of the {processes} "
            f"processes, but it is {objects}; set another with "
            "--config.train.models_per_batch=VALUE."
        )
    if asked % processes:
        raise ValueError(
            f"config.run.devices must be 0 or a multiple of the {processes} processes, "
            f"but it is {asked}; it counts the devices of all of them."
        )
    each = asked // processes or find_share(objects // processes, there)
    if each > there:
        raise ValueError(
            f"config.run.devices must be at most {there * processes}, the devices that "
            f"jax has, but it is {asked}; set --config.run.devices=0 for as many as "
            "there are."
        )
    chosen = [device for found in local for device in found[:each]]
    return Mesh(np.array(chosen), (AXIS,))


def find_share(objects: int, devices: int) -> int:
    """The largest number, at most `devices`, that divides the objects; at least 1."""
    return max(n for n in range(1, devices + 1) if objects % n == 0)


def find_own(objects: int) -> slice:
    """Which of the objects of a batch this process reads, for its own devices."""
    each = objects // jax.process_count()
    return slice(each * jax.process_index(), each * (jax.process_index() + 1))


def assemble(rows: dict[str, np.ndarray], config: Config) -> dict[str, Any]:
    """The batch of which every process has read its own rows, see `find_own`."""
    if jax.process_count() == 1:
        return dict(rows)
    parts = NamedSharding(make_mesh(config), OBJECTS)
    return {
        name: jax.make_array_from_process_local_data(parts, array)
        for name, array in rows.items()
    }


def choose_parts(tree: Any, mesh: Mesh) -> Any:
    """The partition of each array: by columns where it is large, else whole."""
    is_alone = jax.process_count() == 1
    least = SHARED_WEIGHTS if is_alone else SHARED_BETWEEN_PROCESSES

    def choose(array):
        shape = jnp.shape(array)
        is_large = len(shape) == 2 and shape[0] * shape[1] >= least
        return COLUMNS if is_large and shape[1] % mesh.size == 0 else WHOLE

    return jax.tree.map(choose, tree)


def share_padded(function: Callable, mesh: Mesh, in_specs: tuple) -> Callable:
    """`shard_map` of a function of a state and arrays of n objects; n need not divide.

    All devices have as many objects: the last one is repeated, and cut off again.
    Arguments that are `WHOLE` stay as they are.
    """
    shared = jax.shard_map(
        function, mesh=mesh, in_specs=in_specs, out_specs=OBJECTS, check_vma=False
    )

    def pad(state, *arguments):
        count = len(jax.tree.leaves(arguments[0])[0])
        rows = jnp.minimum(jnp.arange(count + -count % mesh.size), count - 1)
        padded = (
            jax.tree.map(lambda a: a[rows], argument) if part == OBJECTS else argument
            for argument, part in zip(arguments, in_specs[1:], strict=True)
        )
        output = shared(state, *padded)
        return jax.tree.map(lambda array: array[:count], output)

    return pad


def take_own(array: jax.Array) -> jax.Array:
    """Inside `shard_map`: this device's share of the leading axis."""
    size = array.shape[0] // jax.lax.axis_size(AXIS)
    return jax.lax.dynamic_slice_in_dim(array, jax.lax.axis_index(AXIS) * size, size)


def sharing_columns() -> contextlib.AbstractContextManager:
    """Inside `shard_map`: a context in which layers that have own columns compute all.

    A layer is shared where its weights have fewer columns than it has features.
    """
    return nn.intercept_methods(_share_columns)


def _share_columns(call, args, kwargs, context):
    """Own columns of all rows, exchanged for all columns of the device's own rows."""
    layer = context.module
    if not isinstance(layer, nn.Dense) or context.method_name != "__call__":
        return call(*args, **kwargs)
    kernel = layer.get_variable("params", "kernel")
    if kernel is None or kernel.shape[1] == layer.features:
        return call(*args, **kwargs)
    rows = jax.lax.all_gather(args[0], AXIS, tiled=True)
    columns = jnp.matmul(rows, kernel)
    own = jax.lax.all_to_all(columns, AXIS, split_axis=0, concat_axis=1, tiled=True)
    return own + layer.get_variable("params", "bias")[None]


def sum_whole(tree: Any, parts: Any) -> Any:
    """Inside `shard_map`: arrays of which every device has the whole, summed over them.

    Joined to one array first: between processes each exchange costs about a
    millisecond, and XLA's own exchange of many arrays takes four times as long as that
    of one (docs/log.md).
    """
    arrays, structure = jax.tree.flatten(tree)
    is_whole = [part == WHOLE for part in structure.flatten_up_to(parts)]
    flat, restore = ravel_pytree(
        [a for a, w in zip(arrays, is_whole, strict=True) if w]
    )
    summed = iter(restore(jax.lax.psum(flat, AXIS)))
    return structure.unflatten(
        [next(summed) if w else a for a, w in zip(arrays, is_whole, strict=True)]
    )


def compute_norms(
    trees: dict[str, Any], parts: dict[str, Any], is_measured: jax.Array
) -> dict[str, jax.Array]:
    """Inside `shard_map`: roots of the sums of all squares of partitioned arrays; ().

    Reading every gradient once more takes a tenth of a step. Where `is_measured` () is
    false, the results are -1, or NaN where a vector among the arrays (the gradient of a
    layer's biases) is not finite: a cheap sign that others are not.
    """

    def select(name, is_chosen):
        arrays, structure = jax.tree.flatten(trees[name])
        pairs = zip(arrays, structure.flatten_up_to(parts[name]), strict=True)
        return [array for array, part in pairs if is_chosen(array, part)]

    def sum_squares(name, is_whole):
        chosen = select(name, lambda _, part: (part == WHOLE) == is_whole)
        return sum((jnp.sum(jnp.square(array)) for array in chosen), jnp.zeros(()))

    def measure():
        shared = {name: sum_squares(name, False) for name in trees}
        shared = sum_whole(shared, dict.fromkeys(trees, WHOLE))
        return {n: jnp.sqrt(sum_squares(n, True) + shared[n]) for n in trees}

    def look():
        vectors = {n: select(n, lambda array, _: array.ndim == 1) for n in trees}
        return {n: 0 * sum(map(jnp.sum, found)) - 1.0 for n, found in vectors.items()}

    return jax.lax.cond(is_measured, measure, look)
