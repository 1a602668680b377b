"""What a case is, and how cases run: in every dtype, against their oracles."""

import dataclasses
import importlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import DTYPES, SUBJECTS
from dpc_jax.measure.stability.oracles import COMPLEX, REAL

WIDE = DTYPES[:2]
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
    # Float64 arrays. They are rounded to each dtype, and the oracle gets the rounded
    # numbers, so that an error is the function's own.
    inputs: tuple
    # The same function in numpy, for real and complex long doubles; at a kink its slope
    # is the right one-sided derivative. None takes the function itself in float64,
    # where only rounding is in question.
    oracle: Callable | None
    # Largest errors of the value, and of the gradient of Σ w·output to each input (None
    # without a gradient), in units of the dtype's epsilon; relative to the largest
    # magnitude of what is right, or to the floor.
    value_tolerance: float
    gradient_tolerance: float | None
    floor: float = 0.0
    gradient_floor: float = 0.0
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
    """What became of a case in one dtype."""

    subject: str
    case: str
    dtype: str
    # By name an error and the largest that passes, or None where it only has to be
    # finite. Those of values and gradients are the worst of all modes, and relative.
    errors: Mapping[str, tuple[float, float | None]] = dataclasses.field(
        default_factory=dict
    )
    is_finite: bool = True  # whether all values and gradients are
    found: str = ""  # what else did not hold

    @property
    def ratios(self) -> dict[str, float]:
        """Error over tolerance of what has one."""
        return {
            name: error / tolerance if tolerance else math.inf if error else 0.0
            for name, (error, tolerance) in self.errors.items()
            if tolerance is not None
        }

    @property
    def passes(self) -> bool:
        """Whether all is finite, within the tolerances, and nothing else was found."""
        is_near = all(ratio <= 1 for ratio in self.ratios.values())  # no NaN
        return self.is_finite and is_near and not self.found

    def describe_failure(self) -> str:
        """One sentence on a row outside its tolerance."""
        reasons = [] if self.is_finite else ["a value or gradient is not finite"]
        reasons += [
            "the {} is {:.2e}, the tolerance {:.2e}".format(name, *self.errors[name])
            for name, ratio in self.ratios.items()
            if not ratio <= 1
        ]
        reasons += [self.found] * bool(self.found)
        return f"{self.subject}, {self.case}, {self.dtype}: {' and '.join(reasons)}."


def run_subject(
    subject: str,
    *,
    dtypes: tuple[str, ...] | None = None,
    quick: bool = False,
    seed: int = 0,
) -> list[Row]:
    """Rows of a subject.

    Args:
      dtypes: of the cases; None for all.
      quick: whether to run a small version: under `vmap` alone, without slow cases, and
        compiled without XLA's optimisations.
      seed: of the random draws.
    """
    module = importlib.import_module(f"{__package__}.{SUBJECTS[subject]}")
    if hasattr(module, "CASES"):
        cases = module.CASES[subject]
        return list(run_cases(subject, cases, dtypes=dtypes, quick=quick))
    return list(module.run(quick=quick, seed=seed))


def run_cases(
    subject: str,
    cases: Iterable[Case],
    *,
    dtypes: tuple[str, ...] | None = None,
    quick: bool = False,
) -> Iterator[Row]:
    """Rows of all cases, in some dtypes or in all that a case names.

    Cases that share a compiled program run at once under `vmap`, and in the full form
    also one after the other under `jit`.
    """
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        if quick and case.is_slow:
            continue
        has_gradient = case.gradient_tolerance is not None
        key = (case.function, has_gradient, *(x.shape for x in case.inputs))
        groups.setdefault(key, []).append(case)
    for group in groups.values():
        for dtype in dtypes or DTYPES:
            chosen = [c for c in group if dtype in c.dtypes and _fits(c, dtype)]
            if chosen:
                yield from _run_group(subject, chosen, dtype, quick)


def _fits(case, dtype) -> bool:
    """Whether the dtype can hold the inputs at all."""
    largest = float(jnp.finfo(dtype).max)
    return all(np.all(np.abs(x) <= largest) for x in case.inputs)


def _run_group(subject, group, dtype, quick):
    call = _make_call(group[0])
    options = QUICKLY if quick else None
    single = jax.jit(call, compiler_options=options)
    with jax.enable_x64(dtype == "float64"):
        inputs = [tuple(jnp.asarray(x, dtype) for x in c.inputs) for c in group]
        stacked = [jnp.stack(arrays) for arrays in zip(*inputs, strict=True)]
        together = _fetch(jax.jit(jax.vmap(call), compiler_options=options)(*stacked))
        alone = [] if quick else [_fetch(single(*arrays)) for arrays in inputs]
    for i, case in enumerate(group):
        results = [jax.tree.map(lambda a, i=i: a[i], together), *alone[i : i + 1]]
        expected = _refer(case, _fetch(inputs[i]), single)
        yield _judge(subject, case, dtype, results, expected)


def _refer(case, inputs, call):
    """The right outputs and gradients of a case."""
    if case.oracle is None:
        with jax.enable_x64(True):
            return _fetch(call(*inputs))
    outputs = jax.tree.leaves(case.oracle(*(x.astype(REAL) for x in inputs)))
    if case.gradient_tolerance is None:
        return outputs, ()
    return outputs, differentiate_oracle(case.oracle, inputs, make_weights(outputs))


def _make_call(case):
    """(outputs, gradients of Σ w·output) of a case's function."""

    def flatten(*arrays):
        return jax.tree.leaves(case.function(*arrays))

    def call(*arrays):
        if case.gradient_tolerance is None:
            return flatten(*arrays), ()
        outputs, pull_back = jax.vjp(flatten, *arrays)
        weights = zip(make_weights(outputs), outputs, strict=True)
        return outputs, pull_back([jnp.asarray(w, o.dtype) for w, o in weights])

    return call


def _fetch(tree):
    return jax.tree.map(lambda a: np.asarray(a, np.float64), jax.device_get(tree))


def _judge(subject, case, dtype, results, expected):
    """The row of one case, by (outputs, gradients) that were found and expected."""
    only_finite = not case.is_half_checked and dtype in ("bfloat16", "float16")
    errors = {}
    for i, (name, tolerance, floor) in enumerate(
        (
            ("value error", case.value_tolerance, case.floor),
            ("gradient error", case.gradient_tolerance, case.gradient_floor),
        )
    ):
        if tolerance is not None:
            pairs = (compare(found[i], expected[i], dtype, floor) for found in results)
            most = None if only_finite else tolerance * float(jnp.finfo(dtype).eps)
            errors[name] = max(pairs), most
    is_finite = all(np.all(np.isfinite(a)) for a in jax.tree.leaves(results))
    return Row(subject, case.name, dtype, errors, is_finite)


def make_weights(outputs: Sequence[Any]) -> list[np.ndarray]:
    """Fixed weights w for the sum Σ w·output whose gradient is compared.

    They differ from entry to entry, so that errors of opposite sign do not cancel, and
    have few binary digits, so that every dtype represents them exactly.
    """
    ends = np.cumsum([np.size(output) for output in outputs])
    return [
        (((np.arange(end - np.size(output), end) * 29) % 64 - 24) / 32).reshape(
            np.shape(output)
        )
        for output, end in zip(outputs, ends, strict=True)
    ]


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
            moved = [x.astype(COMPLEX) for x in inputs]
            moved[place][index] += 1j * step
            outputs = jax.tree.leaves(oracle(*moved))
            pairs = zip(weights, outputs, strict=True)
            gradient[index] = sum(np.sum(w * np.imag(out) / step) for w, out in pairs)
        gradients.append(gradient)
    return tuple(gradients)


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
        scale = max(np.max(np.abs(b)), floor)
        if error > tiny:
            worst = max(worst, float(error / scale) if scale > tiny else math.inf)
    return worst
