"""What a case of the catalogue is, tables of cases, and the derivative of an oracle."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from dpc_jax.measure.stability.cases.names import DTYPES as DTYPES

WIDE = ("float64", "float32")
IN_WIDE = {"dtypes": WIDE}  # the changes of a row that 16 bits cannot hold
# The oracles compute in long double. On x86 it has 64 bits of fraction and 15 of
# exponent, so the squares of 1e30 and 1e-30 are well within its range. On every machine
# it is at least float64.
REAL, COMPLEX = np.longdouble, np.clongdouble


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One function at one input where it may break."""

    name: str  # what is extreme about the input; unique within the subject
    # Maps the inputs as arrays to an array or a tuple of arrays. Cases with the same
    # function object and the same shapes share compiled programs.
    function: Callable
    # Float64 arrays. They are rounded to each dtype, and the oracle gets the rounded
    # numbers, so that an error is the function's own.
    inputs: tuple
    # The same function in numpy, for real and complex long doubles. It shares no code
    # with the package.
    oracle: Callable
    # Largest error of the value, in units of the dtype's epsilon, relative to the
    # largest magnitude in the oracle's output, or to `floor`.
    value_tolerance: float
    # The same for the gradient of Σ w·output to each input; None where the function has
    # no gradient.
    gradient_tolerance: float | None
    because: str  # where the tolerances come from
    subject: str = ""  # the chapter of the report, which the catalogue adds
    floor: float = 0.0  # errors of the value are relative to at least this magnitude
    # The same for the gradient; one number, or one for each input
    gradient_floor: float | tuple[float, ...] = 0.0
    # (inputs, weights) -> the gradients of Σ w·output, one for each input. None
    # differentiates the oracle by complex steps. Kinks need it, to say which one-sided
    # derivative is right.
    slope: Callable | None = None
    dtypes: tuple[str, ...] = DTYPES  # the case runs in these
    # "checked", or "finite" if results in 16 bits only have to be finite
    half: str = "checked"
    limit: str = ""  # the documented limit that the case shows, if any
    # False for numpy functions, which run without jit and gradient
    is_traced: bool = True

    def __post_init__(self):
        inputs = tuple(np.asarray(x, np.float64) for x in self.inputs)
        object.__setattr__(self, "inputs", inputs)


def make_cases(
    title: str,
    function: Callable,
    oracle: Callable | None,
    tolerances: tuple[float, float | None],
    rows: Iterable[tuple],
    **shared: Any,
) -> list[Case]:
    """The cases of one function from a table, one for each row.

    A case is called "title: name", or "title" without a name. Tolerances are those of
    the value and of the gradient. A row is (name, input, input, ...). A dict at its end
    holds the fields of `Case` in which it differs from the others, for example an
    oracle of its own; **shared are other fields that are the same for all.
    """
    value, gradient = tolerances
    shared |= {"function": function, "oracle": oracle}
    shared |= {"value_tolerance": value, "gradient_tolerance": gradient}
    cases = []
    for name, *inputs in rows:
        changes = inputs.pop() if isinstance(inputs[-1], dict) else {}
        name = f"{title}: {name}" if name else title
        cases.append(Case(name=name, inputs=tuple(inputs), **shared | changes))
    return cases


def as_tuple(outputs: Any) -> tuple:
    """The outputs as a tuple, also those of a function that returns one array."""
    return tuple(outputs) if isinstance(outputs, tuple | list) else (outputs,)


def make_weights(outputs: Iterable[Any]) -> list[np.ndarray]:
    """Fixed weights w for the sum Σ w·output whose gradient is compared.

    They differ from entry to entry, so that errors of opposite sign do not cancel, and
    have few binary digits, so that every dtype represents them exactly.
    """
    weights, start = [], 0
    for output in outputs:
        size = int(np.prod(np.shape(output)))
        numbers = ((np.arange(start, start + size) * 29) % 64 - 24) / 32
        weights.append(numbers.reshape(np.shape(output)))
        start += size
    return weights


def differentiate_oracle(
    oracle: Callable, inputs: Iterable[np.ndarray], weights: Iterable[np.ndarray]
) -> tuple[np.ndarray, ...]:
    """Gradient of Σ w·oracle(inputs) by complex steps, exact to long double.

    f(x + ih) = f(x) + ih·f'(x) - O(h²), so the imaginary part over h is the derivative,
    and nothing is subtracted that could cancel (Squire and Trapp, 1998). The oracles
    make their comparisons on real parts.
    """
    inputs = tuple(inputs)
    gradients = []
    for place, array in enumerate(inputs):
        gradient = np.zeros(array.shape, REAL)
        for index in np.ndindex(array.shape):
            size = abs(REAL(array[index]))
            step = REAL(1e-60) * size if size else REAL("1e-2000")
            moved = [np.asarray(x, COMPLEX) for x in inputs]
            moved[place] = moved[place].copy()
            moved[place][index] += 1j * step
            outputs = as_tuple(oracle(*moved))
            gradient[index] = sum(
                np.sum(w * np.imag(out) / step)
                for w, out in zip(weights, outputs, strict=True)
            )
        gradients.append(gradient)
    return tuple(gradients)
