"""Runs cases in every dtype, under jit, vmap and grad, against the oracles."""

import functools
import importlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import DTYPES, SUBJECTS
from dpc_jax.measure.stability.case import Case, Row
from dpc_jax.measure.stability.oracles import COMPLEX, REAL

# Of programs that run once: compiling them takes most of the time.
QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}


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
    return list(module.ROWS[subject](dtypes=dtypes, quick=quick, seed=seed))


def tabulate(**tables: Iterable[Case]) -> dict[str, Callable[..., Iterator[Row]]]:
    """By subject the call that gives the rows of its cases."""
    return {
        name: functools.partial(run_cases, name, cases)
        for name, cases in tables.items()
    }


def run_cases(
    subject: str,
    cases: Iterable[Case],
    *,
    dtypes: tuple[str, ...] | None = None,
    quick: bool = False,
    **_,
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
    epsilon = float(jnp.finfo(dtype).eps)
    only_finite = not case.is_half_checked and dtype in ("bfloat16", "float16")

    def scale(tolerance):
        return None if tolerance is None or only_finite else tolerance * epsilon

    floors = case.floor, case.gradient_floor
    value_error, gradient_error = (
        max(compare(found[i], expected[i], dtype, floor=floors[i]) for found in results)
        for i in range(2)
    )
    return Row(
        subject=subject,
        case=case.name,
        dtype=dtype,
        value_error=value_error,
        value_tolerance=scale(case.value_tolerance),
        gradient_error=None if case.gradient_tolerance is None else gradient_error,
        gradient_tolerance=scale(case.gradient_tolerance),
        is_finite=all(np.all(np.isfinite(a)) for a in jax.tree.leaves(results)),
        because=case.because,
    )


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
    *,
    floor: float | tuple[float, ...] = 0.0,
) -> float:
    """Largest error relative to the largest magnitude of its array, or to `floor`.

    Errors below the dtype's smallest normal number count as zero, because processors
    flush such numbers. An array of another shape, or with numbers that are not finite,
    is infinitely wrong.
    """
    tiny = float(jnp.finfo(dtype).tiny)
    worst = 0.0
    floors = np.broadcast_to(floor, len(expected))
    for a, b, lowest in zip(found, expected, floors, strict=True):
        if np.shape(a) != np.shape(b) or not np.all(np.isfinite(a)):
            return math.inf
        if np.size(b) == 0:
            continue
        b = np.real(b).astype(REAL)
        assert np.all(np.isfinite(b)), "an oracle that is not finite judges nothing"
        error = np.max(np.abs(np.asarray(a, REAL) - b))
        scale = max(np.max(np.abs(b)), lowest)
        if error > tiny:
            worst = max(worst, float(error / scale) if scale > tiny else math.inf)
    return worst
