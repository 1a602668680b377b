"""Runs cases in every dtype, under jit, vmap and grad, and compares."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any

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
    """What became of a case in one dtype; errors are relative, tolerances too.

    Attributes:
      subject, case, dtype: which.
      value_error, gradient_error: the worst over jit and vmap; None without a gradient.
      value_tolerance, gradient_tolerance: None where only finiteness is asked.
      is_finite: values and gradients.
      passes: finite, and within the tolerances.
      limit: what is documented.
      because: where the tolerances come from.
    """

    subject: str
    case: str
    dtype: str
    value_error: float
    value_tolerance: float | None
    gradient_error: float | None
    gradient_tolerance: float | None
    is_finite: bool
    passes: bool
    limit: str
    because: str


def run_cases(
    cases: Iterable[Case],
    *,
    dtypes: tuple[str, ...] | None = None,
    modes: tuple[str, ...] = MODES,
    compiler_options: dict[str, Any] | None = None,
) -> Iterator[Row]:
    """Rows of all cases, group by group of those that share compiled programs.

    Args:
      cases: of the catalogue.
      dtypes: those to run; None for all that a case names.
      modes: of "jit" (one case at a time) and "vmap" (all of a group at once).
      compiler_options: of XLA, as `jax.jit` takes them; None for its own.
    """
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        has_gradient = case.gradient_tolerance is not None
        key = (case.function, has_gradient, *(x.shape for x in case.inputs))
        groups.setdefault(key, []).append(case)
    for group in groups.values():
        if not group[0].is_traced:
            if dtypes is None or "float64" in dtypes:
                yield from (_judge_plain(case) for case in group)
            continue
        for dtype in dtypes or DTYPES:
            chosen = [c for c in group if dtype in c.dtypes and _fits(c, dtype)]
            if chosen:
                yield from _run_group(chosen, dtype, modes, compiler_options)


def _fits(case, dtype) -> bool:
    """Whether the dtype can hold the inputs at all."""
    largest = float(jnp.finfo(dtype).max)
    return all(np.all(np.abs(x) <= largest) for x in case.inputs)


def _run_group(group, dtype, modes, compiler_options):
    is_wide = dtype == "float64"
    with jax.enable_x64(is_wide):
        inputs = [tuple(jnp.asarray(x, dtype) for x in c.inputs) for c in group]
        shapes = jax.eval_shape(group[0].function, *inputs[0])
        weights = tuple(make_weights(as_tuple(shapes)))
        call = _make_call(group[0], weights)
        results = [[] for _ in group]
        if "jit" in modes:
            single = jax.jit(call, compiler_options=compiler_options)
            for result, arrays in zip(results, inputs, strict=True):
                result.append(_fetch(single(*arrays)))
        if "vmap" in modes:
            stacked = [jnp.stack(arrays) for arrays in zip(*inputs, strict=True)]
            many = jax.jit(jax.vmap(call), compiler_options=compiler_options)
            together = _fetch(many(*stacked))
            for i, result in enumerate(results):
                result.append(jax.tree.map(lambda a, i=i: a[i], together))
        rounded = [tuple(np.asarray(x, np.float64) for x in xs) for xs in inputs]
    for case, arrays, found in zip(group, rounded, results, strict=True):
        yield judge(case, dtype, arrays, weights, found)


def _make_call(case, weights):
    """(outputs, gradients of Σ w·output) of a case's function."""

    def total(*arrays):
        outputs = as_tuple(case.function(*arrays))
        parts = [
            jnp.sum(jnp.asarray(w, o.dtype) * o)
            for w, o in zip(weights, outputs, strict=True)
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


def judge(case: Case, dtype: str, inputs, weights, results) -> Row:
    """Compare what was found in each mode with the oracle; a row of the report."""
    epsilon = float(jnp.finfo(dtype).eps)
    outputs = as_tuple(case.oracle(*(np.asarray(x, REAL) for x in inputs)))
    has_gradient = case.gradient_tolerance is not None
    if has_gradient and case.slope is not None:
        slopes = case.slope(inputs, weights)
    elif has_gradient:
        slopes = differentiate_oracle(case.oracle, inputs, weights)
    is_finite, value_error, gradient_error = True, 0.0, 0.0 if has_gradient else None
    for values, gradients in results:
        is_finite &= all(np.all(np.isfinite(a)) for a in (*values, *gradients))
        value_error = max(
            value_error, compare(values, outputs, dtype, floor=case.floor)
        )
        if has_gradient:
            gradient_error = max(
                gradient_error,
                compare(gradients, slopes, dtype, floor=case.gradient_floor),
            )
    only_finite = case.half == "finite" and dtype in ("bfloat16", "float16")
    value_tolerance = None if only_finite else case.value_tolerance * epsilon
    gradient_tolerance = (
        case.gradient_tolerance * epsilon if has_gradient and not only_finite else None
    )
    passes = bool(is_finite)
    if value_tolerance is not None:
        passes &= value_error <= value_tolerance
    if gradient_tolerance is not None:
        passes &= gradient_error <= gradient_tolerance
    return Row(
        case.subject,
        case.name,
        dtype,
        value_error,
        value_tolerance,
        gradient_error,
        gradient_tolerance,
        bool(is_finite),
        bool(passes),
        case.limit,
        case.because,
    )


def compare(
    found, expected, dtype: str, *, floor: float | tuple[float, ...] = 0.0
) -> float:
    """Largest error relative to the largest magnitude of its array, or to `floor`.

    What is smaller than the dtype's smallest normal number counts as zero, as it does
    on processors that flush such numbers. Infinity where something is not finite.
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
                "expected the oracle to be finite, but it is not; it judges nothing."
            )
        error = np.max(np.abs(np.asarray(a, REAL) - b))
        scale = max(np.max(np.abs(b)), lowest)
        if error > tiny:
            worst = max(worst, float(error / scale) if scale > tiny else math.inf)
    return worst


def _judge_plain(case: Case) -> Row:
    values = tuple(np.asarray(v, float) for v in as_tuple(case.function(*case.inputs)))
    return judge(case, "float64", case.inputs, (), [(values, ())])
