"""What an array must look like; each mistake in a sentence."""

import numbers

import chex
import jax.numpy as jnp


def check_array(name: str, value, *shapes, hint: str = "use jax.vmap over several"):
    """The value as an array of floating point numbers in one of some shapes.

    Args:
      name: of the argument. value: what came for it.
      *shapes: tuples of sizes, None for any; a first `...` stands for any axes.
      hint: what to do about another shape.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    array = convert(name, value)
    if not any(_fits(array.shape, shape) for shape in shapes):
        wanted = " or ".join(_describe(shape) for shape in shapes)
        raise ValueError(
            f"{name} must have shape {wanted}, but it has {list(array.shape)}; {hint}."
        )
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise ValueError(
            f"{name} must be floating point numbers, but they are {array.dtype}; "
            f"convert them with {name}.astype('float32')."
        )
    return array


def check_number(name: str, value) -> chex.Array:
    """The value as an array of shape (), real.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    array = convert(name, value)
    if array.shape != () or jnp.iscomplexobj(array):
        raise ValueError(
            f"{name} must be one real number, but it has shape {list(array.shape)} and "
            f"dtype {array.dtype}; use jax.vmap over several."
        )
    return array


def check_at_least_zero(name: str, value):
    """Refuse a plain number below zero, or none; what an array holds is not looked at.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    if isinstance(value, numbers.Real) and not value >= 0:
        raise ValueError(
            f"{name} must be at least 0 voxels, but it is {value}; 0 leaves each point "
            "in its cell."
        )


def check_sides(name: str, shape):
    """Refuse what is not three positive integers.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    is_triple = isinstance(shape, tuple | list) and len(shape) == 3
    if not (is_triple and all(is_count(side) and side > 0 for side in shape)):
        raise ValueError(
            f"{name} must be three positive integers (rows, cols, depth), but it is "
            f"{shape!r}; give for example (64, 64, 64)."
        )


def check_count(name: str, value):
    """Refuse what is not an integer of at least zero.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    if not (is_count(value) and value >= 0):
        raise ValueError(
            f"{name} must be an integer of at least 0, but it is {value!r}; give 0 to "
            "leave it out."
        )


def is_count(value) -> bool:
    """Whether a static number is an integer, and no truth value."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def convert(name: str, value) -> chex.Array:
    """The value as an array.

    Raises:
      ValueError: where it is none, naming the argument and what came.
    """
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
    return len(found) == len(wanted) and all(w in (None, f) for f, w in pairs)


def _describe(shape):
    words = {None: "N", ...: "..."}
    return "[" + ", ".join(words.get(size, str(size)) for size in shape) + "]"
