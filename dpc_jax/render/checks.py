"""Refusing wrong arguments: a ValueError says what was expected and what came."""

import numbers
from collections.abc import Sequence
from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

_SEVERAL = "use jax.vmap over several"


def check_real(
    name: str, value: ArrayLike | None, *shapes: tuple, hint: str = _SEVERAL
) -> jax.Array:
    """Convert a value to an array of real numbers that has one of some shapes.

    In a shape None and a letter stand for any size, and `...` in the first place for
    any number of axes. The hint says what to do about another shape.
    """
    array = _convert(name, value)
    if not any(_fits(array.shape, shape) for shape in shapes):
        wanted = " or ".join(_describe(shape) for shape in shapes)
        raise ValueError(
            f"{name} must have shape {wanted}, but it has {list(array.shape)}; {hint}."
        )
    if jnp.iscomplexobj(array):
        raise ValueError(
            f"{name} must be real, but it is {array.dtype}; pass its real part."
        )
    return array


def check_array(
    name: str, value: ArrayLike | None, *shapes: tuple, hint: str = _SEVERAL
) -> jax.Array:
    """Convert as `check_real`, but refuse integers and truth values too."""
    array = check_real(name, value, *shapes, hint=hint)
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise ValueError(
            f"{name} must be floating point numbers, but they are {array.dtype}; "
            f"convert them with {name}.astype('float32')."
        )
    return array


def check_number(name: str, value: ArrayLike | None) -> jax.Array:
    """Convert one real number to an array of shape ()."""
    return check_real(name, value, ())


def check_choice(name: str, value: str, choices: Sequence[str], hint: str) -> None:
    """Refuse a word that is not among the choices."""
    if value not in choices:
        raise ValueError(
            f"{name} must be one of {choices}, but it is {value!r}; {hint}."
        )


def check_at_least_zero(name: str, value: Any) -> None:
    """Refuse a plain number that is negative or NaN; arrays may be traced and pass."""
    if isinstance(value, numbers.Real) and not float(value) >= 0:
        raise ValueError(
            f"{name} must be at least 0 voxels, but it is {value}; 0 leaves each point "
            "in its cell."
        )


def check_sides(name: str, shape: Any) -> None:
    """Refuse anything but three positive integers."""
    if not are_sides(shape):
        raise ValueError(
            f"{name} must be three positive integers (rows, cols, depth), but it is "
            f"{shape!r}; give for example (64, 64, 64)."
        )


def check_count(name: str, value: Any) -> None:
    """Refuse anything but an integer of at least zero."""
    if not (is_count(value) and value >= 0):
        raise ValueError(
            f"{name} must be an integer of at least 0, but it is {value!r}; give 0 to "
            "leave it out."
        )


def check_type(name: str, value: Any, kind: type, example: str) -> None:
    """Refuse anything but an instance of a public class."""
    if not isinstance(value, kind):
        raise ValueError(
            f"{name} must be a dpc_jax.{kind.__name__}, but it is of type "
            f"{type(value).__name__}; write for example {example}."
        )


def is_count(value: Any) -> bool:
    """Whether a static value is an integer; True and False are not."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def are_sides(shape: Any) -> TypeGuard[Sequence[int]]:
    """Whether a static value is a triple of positive integers."""
    is_triple = isinstance(shape, tuple | list) and len(shape) == 3
    return is_triple and all(is_count(side) and side > 0 for side in shape)


def _convert(name, value):
    try:
        if value is None:
            raise TypeError
        return jnp.asarray(value)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} must be an array of numbers, but it is of type "
            f"{type(value).__name__}; pass a NumPy or JAX array."
        ) from error


def _fits(found, wanted):
    if wanted[:1] == (...,):
        wanted = wanted[1:]
        found = found[max(0, len(found) - len(wanted)) :]
    pairs = zip(found, wanted, strict=False)
    return len(found) == len(wanted) and all(
        w is None or isinstance(w, str) or w == f for f, w in pairs
    )


def _describe(shape):
    if not shape:
        return "()"
    words = {None: "N", ...: "..."}
    return "[" + ", ".join(words.get(size, str(size)) for size in shape) + "]"
