"""Runs cases in every dtype, under jit, vmap and grad, and compares."""

import dataclasses
import functools
import math
from collections.abc import Iterable, Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases.case import (
    DTYPES,
    REAL,
    Case,
    as_tuple,
    differentiate_oracle,
    make_weights,
)

MODES = ("jit", "vmap")


@dataclasses.dataclass(frozen=True)
class Row:
    """What became of a case in one dtype; errors are relative, tolerances too."""

    subject: str
    case: str
    dtype: str
    value_error: float  # the worst of all modes
    value_tolerance: float | None  # None where the result only has to be finite
    gradient_error: float | None  # None without a gradient
    gradient_tolerance: float | None
    is_finite: bool  # whether all values and gradients are
    passes: bool  # whether the results are finite and the errors within the tolerances
    limit: str  # the documented limit that the case shows, if any
    because: str  # where the tolerances come from

    @property
    def value_ratio(self) -> float | None:
        """Error over tolerance of the value; None without a tolerance."""
        return _divide(self.value_error, self.value_tolerance)

    @property
    def gradient_ratio(self) -> float | None:
        """Error over tolerance of the gradient; None without a tolerance."""
        return _divide(self.gradient_error, self.gradient_tolerance)

    @property
    def worst_ratio(self) -> float:
        """The larger of both ratios; 0 without any."""
        return max(self.value_ratio or 0.0, self.gradient_ratio or 0.0)


def _divide(error, tolerance):
    if error is None or tolerance is None:
        return None
    if tolerance == 0:
        return 0.0 if error == 0 else math.inf
    return error / tolerance


def run_cases(
    cases: Iterable[Case],
    *,
    dtypes: tuple[str, ...] | None = None,
    modes: tuple[str, ...] = MODES,
) -> Iterator[Row]:
    """Rows of all cases, in some dtypes or in all that a case names.

    Cases that share a compiled program run one after another in the mode "jit", and at
    once in the mode "vmap".
    """
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        has_gradient = case.gradient_tolerance is not None
        key = (case.function, has_gradient, *(x.shape for x in case.inputs))
        groups.setdefault(key, []).append(case)
    for group in groups.values():
        if not group[0].is_traced:
            if dtypes is None or "float64" in dtypes:
                yield from map(_judge_plain, group)
            continue
        for dtype in dtypes or DTYPES:
            chosen = [c for c in group if dtype in c.dtypes and _fits(c, dtype)]
            if chosen:
                yield from _run_group(chosen, dtype, modes)


def _fits(case, dtype) -> bool:
    """Whether the dtype can hold the inputs at all."""
    largest = float(jnp.finfo(dtype).max)
    return all(np.all(np.abs(x) <= largest) for x in case.inputs)


def _run_group(group, dtype, modes):
    is_wide = dtype == "float64"
    with jax.enable_x64(is_wide):
        inputs = [tuple(jnp.asarray(x, dtype) for x in c.inputs) for c in group]
        call = _make_call(group[0])
        results = [[] for _ in group]
        if "jit" in modes:
            single = jax.jit(call)
            for result, arrays in zip(results, inputs, strict=True):
                result.append(_fetch(single(*arrays)))
        if "vmap" in modes:
            stacked = [jnp.stack(arrays) for arrays in zip(*inputs, strict=True)]
            many = jax.jit(jax.vmap(call))
            together = _fetch(many(*stacked))
            for i, result in enumerate(results):
                result.append(jax.tree.map(lambda a, i=i: a[i], together))
        rounded = [tuple(np.asarray(x, np.float64) for x in xs) for xs in inputs]
    for case, arrays, found in zip(group, rounded, results, strict=True):
        yield _judge(case, dtype, arrays, found)


def _make_call(case):
    """(outputs, gradients of Σ w·output) of a case's function."""

    def total(*arrays):
        outputs = as_tuple(case.function(*arrays))
        parts = [
            jnp.sum(jnp.asarray(w, o.dtype) * o)
            for w, o in zip(make_weights(outputs), outputs, strict=True)
        ]
        return sum(parts), outputs

    def call(*arrays):
        if case.gradient_tolerance is None:
            return as_tuple(case.function(*arrays)), ()
        gradients, outputs = jax.grad(
            total, argnums=tuple(range(len(arrays))), has_aux=True
        )(*arrays)
        return outputs, gradients

    return call


def _fetch(tree):
    return jax.tree.map(lambda a: np.asarray(a, np.float64), jax.device_get(tree))


def _judge(case, dtype, inputs, results):
    epsilon = float(jnp.finfo(dtype).eps)
    only_finite = case.half == "finite" and dtype in ("bfloat16", "float16")

    def scale(tolerance):
        return None if tolerance is None or only_finite else tolerance * epsilon

    outputs = as_tuple(case.oracle(*(np.asarray(x, REAL) for x in inputs)))
    value_error = max(compare(v, outputs, dtype, floor=case.floor) for v, _ in results)
    gradient_error = None
    if case.gradient_tolerance is not None:
        slope = case.slope or functools.partial(differentiate_oracle, case.oracle)
        slopes = slope(inputs, make_weights(outputs))
        gradient_error = max(
            compare(g, slopes, dtype, floor=case.gradient_floor) for _, g in results
        )
    row = Row(
        subject=case.subject,
        case=case.name,
        dtype=dtype,
        value_error=value_error,
        value_tolerance=scale(case.value_tolerance),
        gradient_error=gradient_error,
        gradient_tolerance=scale(case.gradient_tolerance),
        is_finite=all(np.all(np.isfinite(a)) for a in jax.tree.leaves(results)),
        passes=True,
        limit=case.limit,
        because=case.because,
    )
    return dataclasses.replace(row, passes=row.is_finite and row.worst_ratio <= 1)


def compare(
    found: Sequence[np.ndarray],
    expected: Sequence[np.ndarray],
    dtype: str,
    *,
    floor: float | tuple[float, ...] = 0.0,
) -> float:
    """Largest error relative to the largest magnitude of its array, or to `floor`.

    Errors below the dtype's smallest normal number count as zero, because processors
    flush such numbers. An array of another shape, or with numbers that are not finite,
    is infinitely wrong.

    Raises:
      FloatingPointError: the expected numbers are not finite.
    """
    tiny = float(jnp.finfo(dtype).tiny)
    worst = 0.0
    floors = floor if isinstance(floor, tuple) else (floor,) * len(expected)
    for a, b, lowest in zip(found, expected, floors, strict=True):
        if np.shape(a) != np.shape(b):
            return math.inf
        if np.size(b) == 0:
            continue
        if not np.all(np.isfinite(a)):
            return math.inf
        b = np.real(b).astype(REAL)
        if not np.all(np.isfinite(b)):
            raise FloatingPointError(
                "Expected finite numbers of the oracle, but some are not finite; such "
                "an oracle judges nothing, so correct it."
            )
        error = np.max(np.abs(np.asarray(a, REAL) - b))
        scale = max(np.max(np.abs(b)), lowest)
        if error > tiny:
            worst = max(worst, float(error / scale) if scale > tiny else math.inf)
    return worst


def _judge_plain(case):
    values = tuple(np.asarray(v, float) for v in as_tuple(case.function(*case.inputs)))
    return _judge(case, "float64", case.inputs, [(values, ())])
