"""What a case is, and how cases run: in every dtype, against their oracles."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import DTYPES, QUICK_DTYPES
from dpc_jax.measure.stability.oracles import COMPLEX, REAL

WIDE, HALF = DTYPES[:2], DTYPES[2:]
IN_WIDE = {"dtypes": WIDE}  # the changes of a row that 16 bits cannot hold
# Of programs that run once: compiling them takes most of the time.
QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One function at one input where it may break."""

    name: str  # what is extreme about the input; unique within the subject
    # Maps arrays to an array or a tuple of arrays. Cases with the same function object
    # and the same shapes share compiled programs.
    function: Callable
    # Numbers that are rounded to each dtype. The oracle gets the rounded ones, so that
    # an error is the function's own.
    inputs: tuple
    # The same function in numpy, for real and complex long doubles; at a kink its slope
    # is the right one-sided derivative. None takes the function itself in float64,
    # where only rounding is in question.
    oracle: Callable | None
    # Largest errors of the value, and of the gradient of Σ w·output to each input (None
    # where it is not compared), in units of the dtype's epsilon; relative to the
    # largest magnitude of what is right, or to the floor.
    value_tolerance: float
    gradient_tolerance: float | None
    floor: float = 0.0
    gradient_floor: float = 0.0
    dtypes: tuple[str, ...] = DTYPES  # the case runs in these
    is_half_checked: bool = True  # or results in 16 bits only have to be finite
    is_slow: bool = False  # left out of the quick form


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
    """What became of a case in one dtype."""

    subject: str
    case: str
    dtype: str
    # By name an error and the largest that passes, infinite where the error only has to
    # be finite. Those of values and gradients are relative.
    errors: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    found: str = ""  # what else did not hold

    @property
    def passes(self) -> bool:
        """Whether all is finite, within the tolerances, and nothing else was found."""
        return not self.found and not self._list_outside()

    @property
    def worst(self) -> float:
        """The largest error over its tolerance."""
        return max((error / most for error, most in self.errors.values()), default=0.0)

    def describe_failure(self) -> str:
        """One sentence on a row outside its tolerance."""
        reasons = [
            "the {} is {:.2e}, the tolerance {:.2e}".format(name, *self.errors[name])
            for name in self._list_outside()
        ]
        reasons += [self.found] * bool(self.found)
        return f"{self.subject}, {self.case}, {self.dtype}: {' and '.join(reasons)}."

    def _list_outside(self):
        return [
            name
            for name, (error, most) in self.errors.items()
            if not (math.isfinite(error) and error <= most)
        ]


def run_cases(
    subject: str, cases: Iterable[Case], *, quick: bool = False
) -> Iterator[Row]:
    """Rows of all cases in all dtypes that a case names.

    Cases that share a compiled program run at once under `vmap`, and in the full form
    also one after the other. The quick form leaves slow cases and most dtypes out, and
    compiles without XLA's optimisations.
    """
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        if not (quick and case.is_slow):
            key = (case.function, *map(np.shape, case.inputs))
            groups.setdefault(key, []).append(case)
    for group in groups.values():
        for dtype in QUICK_DTYPES if quick else DTYPES:
            chosen = [c for c in group if dtype in c.dtypes and _fits(c, dtype)]
            if chosen:
                yield from _run_group(subject, chosen, dtype, quick)


def _fits(case, dtype) -> bool:
    """Whether the dtype can hold the inputs at all."""
    largest = float(jnp.finfo(dtype).max)
    return all(np.all(np.abs(x) <= largest) for x in case.inputs)


def _run_group(subject, group, dtype, quick):
    call = functools.partial(_differentiate, group[0].function)
    modes = [jax.vmap(call)]
    if not quick:
        modes.append(functools.partial(jax.lax.map, call))
    with jax.enable_x64(dtype == "float64"):
        stacked = [
            jnp.asarray(np.array(arrays, np.float64), dtype)
            for arrays in zip(*(case.inputs for case in group), strict=True)
        ]
        results = [
            _fetch(jax.jit(mode, compiler_options=QUICKLY if quick else None)(stacked))
            for mode in modes
        ]
    rounded = _fetch(stacked)
    for i, case in enumerate(group):
        inputs, *found = (
            jax.tree.map(lambda a, i=i: np.asarray(a[i]), tree)
            for tree in (rounded, *results)
        )
        yield _judge(subject, case, dtype, found, _refer(case, inputs))


def _differentiate(function, arrays):
    """The outputs of a function, and the gradients of Σ w·output."""
    outputs, pull_back = jax.vjp(lambda *x: jax.tree.leaves(function(*x)), *arrays)
    weights = zip(make_weights(outputs), outputs, strict=True)
    return outputs, pull_back([jnp.asarray(w, o.dtype) for w, o in weights])


def _refer(case, inputs):
    """The right outputs and gradients of a case."""
    if case.oracle is None:
        with jax.enable_x64(True):
            return _fetch(
                jax.jit(_differentiate, static_argnums=0)(case.function, inputs)
            )
    outputs = jax.tree.leaves(case.oracle(*(x.astype(REAL) for x in inputs)))
    if case.gradient_tolerance is None:
        return outputs, ()
    return outputs, differentiate_oracle(case.oracle, inputs, make_weights(outputs))


def _fetch(tree):
    return jax.tree.map(lambda a: np.asarray(a, np.float64), jax.device_get(tree))


def _judge(subject, case, dtype, results, expected):
    """The row of one case, by (outputs, gradients) that were found and expected."""
    is_checked = case.is_half_checked or dtype not in HALF
    unit = float(jnp.finfo(dtype).eps) if is_checked else math.inf
    errors = {}
    for i, (name, tolerance, floor) in enumerate(
        (
            ("value error", case.value_tolerance, case.floor),
            ("gradient error", case.gradient_tolerance, case.gradient_floor),
        )
    ):
        if tolerance is not None:
            worst = max(compare(r[i], expected[i], dtype, floor) for r in results)
            errors[name] = worst, tolerance * unit
    return Row(subject, case.name, dtype, errors)


def make_weights(outputs: Sequence[Any]) -> list[np.ndarray]:
    """Fixed weights w for the sum Σ w·output whose gradient is compared.

    They differ from entry to entry, so that errors of opposite sign do not cancel, and
    have few binary digits, so that every dtype represents them exactly.
    """
    weights, start = [], 0
    for output in outputs:
        numbers = np.arange(start, start + np.size(output))
        weights.append((((numbers * 29) % 64 - 24) / 32).reshape(np.shape(output)))
        start += np.size(output)
    return weights


def differentiate_oracle(
    oracle: Callable, inputs: Sequence[np.ndarray], weights: Iterable[np.ndarray]
) -> list[np.ndarray]:
    """Gradient of Σ w·oracle(inputs) by complex steps, exact to long double.

    f(x + ih) = f(x) + ih·f'(x) - O(h²), so the imaginary part over h is the derivative,
    and nothing is subtracted that could cancel (Squire and Trapp, 1998). The oracles
    make their comparisons on real parts.
    """
    gradients = []
    for place, array in enumerate(inputs):
        gradient = np.zeros(array.shape, REAL)
        for index in np.ndindex(array.shape):
            size = abs(REAL(array[index]))
            step = REAL(1e-60) * size if size else REAL("1e-2000")
            moved = [x.astype(COMPLEX) for x in inputs]
            moved[place][index] += 1j * step
            outputs = jax.tree.leaves(oracle(*moved))
            pairs = zip(weights, outputs, strict=True)
            gradient[index] = sum(np.sum(w * np.imag(out) / step) for w, out in pairs)
        gradients.append(gradient)
    return gradients


def compare(
    found: Sequence[np.ndarray],
    expected: Sequence[np.ndarray],
    dtype: str,
    floor: float = 0.0,
) -> float:
    """Largest error relative to the largest magnitude of its array, or to `floor`.

    Errors below the dtype's smallest normal number count as zero, because processors
    flush such numbers. An array of another shape, or with numbers that are not finite,
    is infinitely wrong.
    """
    tiny = float(jnp.finfo(dtype).tiny)
    worst = 0.0
    for a, b in zip(found, expected, strict=True):
        if np.shape(a) != np.shape(b) or not np.all(np.isfinite(a)):
            return math.inf
        if np.size(b) == 0:
            continue
        b = np.real(b).astype(REAL)
        assert np.all(np.isfinite(b)), "an oracle that is not finite judges nothing"
        error = np.max(np.abs(np.asarray(a, REAL) - b))
        if error > tiny:
            worst = max(worst, float(error / max(np.max(np.abs(b)), floor, tiny)))
    return worst
