"""How much memory a training step needs, told before it is compiled."""

from collections.abc import Callable, Collection
from typing import Any

import jax

from dpc_jax.config import Config
from dpc_jax.learning import schedules, signals
from dpc_jax.learning.step import describe_state, make_train_step
from dpc_jax.networks import ShapePoseNetwork

# Computed where they are used: the compiler never writes them to memory.
_FREE = {"broadcast_in_dim", "iota", "reshape", "squeeze", "copy", "stop_gradient"}
_GB = 1e9
# Largest ratio of the compiler's own layout, on a CPU, to the estimate: 1.1 where views
# are rendered one after the other, 3.0 where all are side by side (docs/gpu.md).
_FACTOR = 3


def check_step_memory(network: ShapePoseNetwork, config: Config) -> None:
    """Print what a training step will take of a device's memory; refuse too much.

    Where the device does not tell its memory, as a CPU, nothing happens.

    Raises:
      ValueError: where the estimate is above the device's memory.
    """
    limit = (jax.local_devices()[0].memory_stats() or {}).get("bytes_limit")
    if limit is None:
        return
    needed = estimate_step_memory(network, config)
    print(describe_memory(needed, limit, config), flush=True)


def describe_memory(needed: int, limit: int, config: Config) -> str:
    """A line about bytes that a step needs, of those that a device has.

    Raises:
      ValueError: where it needs more than there are.
    """
    if needed > limit:
        batch = config.train.models_per_batch
        raise ValueError(
            f"A training step must fit into the device's memory of {limit / _GB:.1f} "
            f"GB, but it is estimated to need {needed / _GB:.1f} GB; set "
            "--config.render.renders_at_once=4 to render fewer views side by side, or "
            f"--config.train.models_per_batch below {batch}."
        )
    return (
        f"Memory of a step: about {needed / _GB:.1f} GB, at most "
        f"{_FACTOR * needed / _GB:.1f}, of {limit / _GB:.1f} GB."
    )


def estimate_step_memory(network: ShapePoseNetwork, config: Config) -> int:
    """Bytes of the largest training step of a run, traced but not compiled.

    That is its last: no later stage has more points or a finer grid.
    """
    state = describe_state(network, config)
    train, size = config.train, config.data.image_size
    views = (train.models_per_batch, train.views_per_batch)
    batch = {
        "images": jax.ShapeDtypeStruct((*views, size, size, 3), "uint8"),
        "masks": jax.ShapeDtypeStruct((*views, size, size), "uint8"),
        "quaternions": jax.ShapeDtypeStruct((*views, 4), "float32"),
        "seeds": jax.ShapeDtypeStruct(views[:1], "uint32"),
    }
    ends = {"depths": (size, size), "translations": (3,), "focal_lengths": ()}
    for name in signals.list_extras(config):
        batch[name] = jax.ShapeDtypeStruct((*views, *ends[name]), "float32")
    for name in signals.list_corners(config):
        dtype = "uint8" if name == "corner_masks" else "float32"
        shape = (train.models_per_batch, 8, size, size)
        batch[name] = jax.ShapeDtypeStruct(shape, dtype)
    stage = schedules.find_stage(train.steps - 1, config.render, steps=train.steps)
    return estimate_peak(make_train_step(network, config, stage), state, batch)


def estimate_peak(function: Callable, *arguments: Any) -> int:
    """The most bytes that a function holds at once, by its traced program.

    Walks through the program and adds up the arrays that are still needed. The compiler
    fuses some operations and keeps their results nowhere, and keeps others longer: its
    own layout takes 0.9 to 3 times the estimate of a training step (docs/gpu.md).

    Args:
      function: jitted or not; the memory of donated arguments is used again.
      *arguments: arrays, or `jax.ShapeDtypeStruct` in their place.
    """
    jaxpr = jax.make_jaxpr(function)(*arguments).jaxpr
    donated = [False] * len(jaxpr.invars)
    if len(jaxpr.eqns) == 1 and "donated_invars" in jaxpr.eqns[0].params:
        donated = jaxpr.eqns[0].params["donated_invars"]
        jaxpr = jaxpr.eqns[0].params["jaxpr"].jaxpr
    given = sum(map(_count_bytes, [*jaxpr.invars, *jaxpr.constvars]))
    lent = {
        v for v, is_donated in zip(jaxpr.invars, donated, strict=True) if is_donated
    }
    return given + _find_peak(jaxpr, lent)


def _find_peak(jaxpr, lent: Collection = ()):
    """The most bytes of results and temporaries; those of inputs `lent` come free."""
    last_use = {}
    for i, equation in enumerate(jaxpr.eqns):
        last_use |= {v: i for v in equation.invars if _is_variable(v)}
    kept = {v for v in jaxpr.outvars if _is_variable(v)}
    sizes: dict[Any, int] = {v: _count_bytes(v) for v in lent}
    live = peak = 0
    for i, equation in enumerate(jaxpr.eqns):
        ending = {v for v in filter(_is_variable, equation.invars) if last_use[v] == i}
        freed = sum(sizes.pop(v, 0) for v in ending - kept)
        needed = [v for v in equation.outvars if v in last_use or v in kept]
        made = {v: _measure(equation, v) for v in needed}
        new = sum(made.values())
        inner = max((_find_peak(part) for part in _list_parts(equation)), default=0)
        # A result may be written over an input that ends here.
        peak = max(peak, live + max(new, inner) - min(freed, new))
        live += new - freed
        sizes |= made
    return max(peak, 0)


def _list_parts(equation):
    """The programs inside an operation: a loop's body, the branches of a switch."""
    for value in jax.tree.leaves(
        list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns")
    ):
        inner = getattr(value, "jaxpr", value)
        if hasattr(inner, "eqns"):
            yield inner


def _measure(equation, variable):
    return 0 if equation.primitive.name in _FREE else _count_bytes(variable)


def _is_variable(value):
    return not hasattr(value, "val")  # a literal has a value


def _count_bytes(variable):
    aval = variable.aval
    if not hasattr(aval, "shape"):
        return 0
    size = 1
    for side in aval.shape:
        size *= side
    return size * (aval.dtype.itemsize if hasattr(aval.dtype, "itemsize") else 4)
