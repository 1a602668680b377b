"""Targets of random draws: a function, the ranges of its inputs, what must hold."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

LARGEST = float(np.finfo(np.float32).max)


@dataclasses.dataclass(frozen=True)
class Range:
    """Float32 arrays that are drawn for one input."""

    shape: tuple[int, ...]  # fixed, so that a function is compiled once
    # Bounds; by default all finite numbers, also subnormal ones
    low: float = -LARGEST
    high: float = LARGEST
    # Bounds of the ordinary numbers that are mixed in; without them, every point would
    # be out of sight.
    usual: tuple[float, float] = (-0.5, 0.5)
    smallest: float = 0.0  # smaller magnitudes become zero
    kind: str = "float"  # "float", or "byte" for uint8


@dataclasses.dataclass(frozen=True)
class Target:
    """A function, and what must hold for every draw."""

    name: str  # as a user writes it
    function: Callable  # maps the inputs as arrays to an array or a tree of arrays
    inputs: tuple[Range, ...]  # their ranges
    # (outputs, *inputs) -> further properties by name, each a bool
    holds: Callable[..., dict[str, Any]] = lambda outputs, *inputs: {}
    limit: str = ""  # the documented range if it is not all finite numbers, and why
    has_gradient: bool = True  # whether every input must have a finite gradient
    is_traced: bool = True  # False for numpy functions
    refusals: tuple[type[Exception], ...] = ()  # exceptions that are documented answers


def promise(name: str, test: Callable[[Any], Any]) -> Callable[..., dict[str, Any]]:
    """For `Target.holds`: a property of the outputs alone."""
    return lambda outputs, *_: {name: test(outputs)}


def is_share(values: jax.Array) -> jax.Array:
    """Whether all values are in [0, 1]."""
    return jnp.all((values >= 0) & (values <= 1))


def make_check(target: Target) -> Callable[..., dict[str, bool]]:
    """A function of drawn arrays that tells for each property whether it holds.

    For a traced function it is one compiled program. The properties are finite outputs,
    finite gradients of Σ ±output, and what else the target promises.
    """
    if not target.is_traced:
        return lambda *arrays: _check_plain(target, arrays)

    def check(*arrays):
        if target.has_gradient:
            outputs, pull_back = jax.vjp(target.function, *arrays)
            gradients = pull_back(jax.tree.map(_alternate, outputs))
        else:
            outputs, gradients = target.function(*arrays), ()
        found = {"finite": _are_finite(outputs)}
        for place, gradient in enumerate(gradients):
            found[f"gradient of input {place}"] = _are_finite(gradient)
        return found | target.holds(outputs, *arrays)

    compiled = jax.jit(check)
    return lambda *arrays: {
        k: bool(v) for k, v in jax.device_get(compiled(*arrays)).items()
    }


def _check_plain(target, arrays):
    try:
        outputs = target.function(*arrays)
    except target.refusals as error:
        # "<Subject> must be <expected>, but <what came>; <what to do>."
        says_all = ", but " in str(error) and "; " in str(error)
        return {"refused in a sentence": says_all}
    leaves = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(outputs)]
    found = {"finite": all(np.isfinite(leaf).all() for leaf in leaves)}
    return found | target.holds(outputs, *arrays)


def _are_finite(tree):
    leaves = jax.tree.leaves(tree)
    return jnp.all(jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def _alternate(output):
    """Cotangents 1, -1, 1, ...: no cell's gradient can hide behind another's."""
    size = output.size
    return (1 - 2 * (jnp.arange(size) % 2)).reshape(output.shape).astype(output.dtype)
