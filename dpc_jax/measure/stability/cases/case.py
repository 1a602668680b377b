"""What a case of the catalogue is, and the derivative of an oracle."""

import dataclasses
from collections.abc import Callable

import numpy as np

DTYPES = ("float64", "float32", "bfloat16", "float16")
WIDE = ("float64", "float32")
# The oracles' numbers: 64 bits of fraction and 15 of exponent on x86, so that squares
# of 1e30 and 1e-30 are ordinary; never less than float64.
REAL, COMPLEX = np.longdouble, np.clongdouble


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One function at one place where it may break.

    Attributes:
      name: what is extreme about it; unique within the subject.
      subject: the chapter of the report.
      function: of the inputs as arrays, giving an array or a tuple of arrays. Cases
        that share it (the same object) and their shapes share compiled programs.
      inputs: float64 arrays; they are rounded to each dtype, and the oracle sees them
        rounded, so that an error is the function's own.
      oracle: the same in numpy for real and complex long doubles, sharing no code with
        the package.
      value_tolerance: largest error of the value, in units of the dtype's epsilon,
        relative to the largest magnitude in the oracle's output, or to `floor`.
      gradient_tolerance: the same of the gradient of Σ w·output, for each input; None
        where the function has none.
      because: where the tolerances come from.
      floor: magnitude of the value that errors are relative to at least; 0 for none.
      gradient_floor: the same of the gradient; one for all inputs or one for each.
      slope: gradients of Σ w·output, as a function (inputs, weights) -> tuple; None is
        the oracle's by complex steps. Needed at kinks, for the side that is taken.
      dtypes: in which the case is run.
      half: "checked", or "finite" where 16 bits are asked only for finite numbers.
      limit: what is documented about it, where the right answer is a limit.
      is_traced: False for functions in numpy, without jit and gradient.
    """

    name: str
    subject: str
    function: Callable
    inputs: tuple
    oracle: Callable
    value_tolerance: float
    gradient_tolerance: float | None
    because: str
    floor: float = 0.0
    gradient_floor: float | tuple[float, ...] = 0.0
    slope: Callable | None = None
    dtypes: tuple[str, ...] = DTYPES
    half: str = "checked"
    limit: str = ""
    is_traced: bool = True

    def __post_init__(self):
        inputs = tuple(np.asarray(x, np.float64) for x in self.inputs)
        object.__setattr__(self, "inputs", inputs)


def as_tuple(outputs) -> tuple:
    """A tuple of outputs, also of a function that gives one array."""
    return tuple(outputs) if isinstance(outputs, tuple | list) else (outputs,)


def make_weights(outputs) -> list[np.ndarray]:
    """Fixed weights w of the sum Σ w·output whose gradient is compared.

    They differ from entry to entry, so that errors of opposite sign do not cancel, and
    are short in binary, so that every dtype has the same.
    """
    weights, start = [], 0
    for output in outputs:
        size = int(np.prod(np.shape(output)))
        numbers = ((np.arange(start, start + size) * 29) % 64 - 24) / 32
        weights.append(numbers.reshape(np.shape(output)))
        start += size
    return weights


def differentiate_oracle(oracle, inputs, weights) -> tuple[np.ndarray, ...]:
    """Gradient of Σ w·oracle(inputs) by complex steps, exact to long double.

    f(x + ih) = f(x) + ih·f'(x) - O(h²): the imaginary part over h is the derivative
    without any subtraction (Squire and Trapp, 1998). The oracles compare real parts.
    """
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
