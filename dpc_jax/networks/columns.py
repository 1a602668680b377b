"""Dense layers whose columns are shared by several devices.

Tensor parallelism (Shoeybi et al., 2019): each device computes some columns, for the
rows of all devices.
"""

import contextlib
import functools

import flax.linen as nn
import jax
import jax.numpy as jnp


def sharing_columns(axis: str) -> contextlib.AbstractContextManager:
    """A context in which layers that have only some of their columns compute all.

    For use inside `jax.shard_map`, whose devices the axis names. A layer is shared
    where its weights have fewer columns than it has features: the device's own.
    """
    return nn.intercept_methods(functools.partial(_share_columns, axis))


def _share_columns(axis, call, args, kwargs, context):
    """Own columns of all rows, exchanged for all columns of the device's own rows."""
    layer = context.module
    if not isinstance(layer, nn.Dense) or context.method_name != "__call__":
        return call(*args, **kwargs)
    kernel = layer.get_variable("params", "kernel")
    if kernel is None or kernel.shape[1] == layer.features:
        return call(*args, **kwargs)
    rows = jax.lax.all_gather(args[0], axis, tiled=True)
    columns = jnp.matmul(rows, kernel)
    own = jax.lax.all_to_all(columns, axis, split_axis=0, concat_axis=1, tiled=True)
    return own + layer.get_variable("params", "bias")[None]
