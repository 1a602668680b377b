"""What a case is, tables of cases, and the outcome of one."""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from dpc_jax.measure.stability import DTYPES

WIDE = DTYPES[:2]
IN_WIDE = {"dtypes": WIDE}  # the changes of a row that 16 bits cannot hold
# Quaternions: of any length, of nearly one, the identity.
SKEW, TURN, STILL = (0.5, -1.0, 2.0, 0.25), (0.8, 0.1, -0.3, 0.2), (1, 0, 0, 0)


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One function at one input where it may break."""

    name: str  # what is extreme about the input; unique within the subject
    # Maps arrays to an array or a tuple of arrays. Cases with the same function object
    # and the same shapes share compiled programs.
    function: Callable
    # Float64 arrays. They are rounded to each dtype, and the oracle gets the rounded
    # numbers, so that an error is the function's own.
    inputs: tuple
    # The same function in numpy, for real and complex long doubles; at a kink its slope
    # is the right one-sided derivative. None takes the function itself in float64,
    # where only rounding is in question.
    oracle: Callable | None
    # Largest errors of the value, and of the gradient of Σ w·output to each input (None
    # without a gradient), in units of the dtype's epsilon; relative to the largest
    # magnitude of what is right, or to the floor, of the gradient one for each input.
    value_tolerance: float
    gradient_tolerance: float | None
    because: str  # where the tolerances come from
    floor: float = 0.0
    gradient_floor: float | tuple[float, ...] = 0.0
    dtypes: tuple[str, ...] = DTYPES  # the case runs in these
    is_half_checked: bool = True  # or results in 16 bits only have to be finite
    is_slow: bool = False  # left out of the quick form

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

    A case is called "title: name". Tolerances are those of the value and of the
    gradient. A row is (name, input, input, ...), and may end in a dict of the fields of
    `Case` in which it differs; **shared are fields that are the same for all.
    """
    value, gradient = tolerances
    shared |= {"value_tolerance": value, "gradient_tolerance": gradient}
    cases = []
    for name, *inputs in rows:
        fields = shared | (inputs.pop() if isinstance(inputs[-1], dict) else {})
        name = f"{title}: {name}"
        cases.append(Case(name, function, tuple(inputs), oracle, **fields))
    return cases


@dataclasses.dataclass(frozen=True)
class Row:
    """What became of a case in one dtype; errors are relative, tolerances too."""

    subject: str
    case: str
    dtype: str
    value_error: float  # the worst of all modes
    value_tolerance: float | None  # None where the result only has to be finite
    gradient_error: float | None = None  # None without a gradient
    gradient_tolerance: float | None = None
    is_finite: bool = True  # whether all values and gradients are
    because: str = ""  # where the tolerances come from
    found: str = ""  # more about a failure

    @property
    def ratios(self) -> dict[str, float]:
        """Error over tolerance of the value and of the gradient, where there is one."""
        pairs = {
            "value": (self.value_error, self.value_tolerance),
            "gradient": (self.gradient_error, self.gradient_tolerance),
        }
        return {
            name: error / tolerance if tolerance else math.inf if error else 0.0
            for name, (error, tolerance) in pairs.items()
            if error is not None and tolerance is not None
        }

    @property
    def passes(self) -> bool:
        """Whether the results are finite and the errors within the tolerances."""
        return self.is_finite and all(r <= 1 for r in self.ratios.values())  # not NaN

    def describe_failure(self) -> str:
        """One sentence on a row outside its tolerance."""
        reasons = [] if self.is_finite else ["a value or gradient is not finite"]
        for name, ratio in self.ratios.items():
            if not ratio <= 1:
                error, most = (
                    getattr(self, f"{name}_{n}") for n in ("error", "tolerance")
                )
                reasons.append(
                    f"the error of the {name} is {error:.2e}, the tolerance {most:.2e}"
                )
        reasons += [self.found] * bool(self.found)
        return f"{self.subject}, {self.case}, {self.dtype}: {' and '.join(reasons)}."
