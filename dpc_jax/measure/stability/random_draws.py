"""Random draws: every function over all float32 numbers, and what must hold of it.

Only `hypothesis`, an extra of the package, can draw: it is imported where it is used,
so that the rest of the package runs without it.
"""

import functools
import importlib.util
from collections.abc import Callable, Iterable, Iterator

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.case import Row
from dpc_jax.measure.stability.draw_targets import Range, Target

DRAWS, QUICK_DRAWS = 10_000, 30
MISSING = (
    "random draws need the library hypothesis, but it is not installed; install it "
    "with pip install 'dpc_jax[test]', or leave this subject out"
)
PROMISE = (
    "values and gradients are finite, and what the function promises holds; a "
    "documented refusal counts as an answer"
)


class _Broken(Exception):
    """A draw broke a property; its arguments are the properties and the draw."""


def run(
    targets: Iterable[Target], *, draws: int, seed: int, tell: Callable = print
) -> Iterator[Row]:
    """A row for each target, whose error is one if a draw broke it.

    The same seed makes the same draws.
    """
    if importlib.util.find_spec("hypothesis") is None:
        yield Row("random", "all functions", "float32", 1.0, 0.0, found=MISSING)
        return
    for target in targets:
        found = draw_inputs(target, draws=draws, seed=seed)
        tell(f"random, {target.name}: {'broken' if found else 'holds'}")
        yield Row(
            *("random", target.name, "float32", float(bool(found)), 0.0),
            limit=target.limit,
            because=PROMISE,
            found=found,
        )


def draw_inputs(target: Target, *, draws: int, seed: int) -> str:
    """Try draws on a target; of one that breaks it the simplest, in words, or ""."""
    import hypothesis
    from hypothesis import strategies

    check = make_check(target)

    # No data base and a fixed seed: the same draws in every run.
    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=draws,
        deadline=None,
        database=None,
        derandomize=False,
        report_multiple_bugs=False,
        verbosity=hypothesis.Verbosity.quiet,
        suppress_health_check=list(hypothesis.HealthCheck),  # pyright: ignore
    )
    @hypothesis.given(strategies.tuples(*(_draw_array(r) for r in target.inputs)))
    def judge(arrays):
        try:
            found = check(*arrays)
        except Exception as error:  # any exception that is not documented is a find
            raise _Broken((f"{type(error).__name__}: {error}",), arrays) from error
        broken = tuple(name for name, holds in found.items() if not holds)
        if broken:
            raise _Broken(broken, arrays)

    try:
        judge()
    except _Broken as error:
        broken, arrays = error.args
        drawn = "; ".join(str(a.tolist()) for a in arrays)
        return f"{', '.join(broken)} did not hold for {drawn}"
    return ""


def _draw_array(wanted: Range):
    """A strategy of arrays of ordinary numbers, alone or mixed with extreme ones."""
    from hypothesis import strategies
    from hypothesis.extra import numpy as arrays

    def make_elements(low, high):
        low, high = float(np.float32(low)), float(np.float32(high))
        numbers = strategies.floats(low, high, width=32)
        floor = wanted.smallest
        return numbers.map(lambda x: x if abs(x) >= floor else 0.0)

    usual = make_elements(*wanted.usual)
    either = strategies.one_of(usual, make_elements(wanted.low, wanted.high))
    return strategies.one_of(
        arrays.arrays(np.float32, wanted.shape, elements=either),
        arrays.arrays(np.float32, wanted.shape, elements=usual),
    )


def make_check(target: Target) -> Callable[..., dict[str, bool]]:
    """A function of drawn arrays that tells for each property whether it holds.

    For a traced function it is one compiled program. The properties are finite outputs,
    finite gradients of Σ ±output, and what the target promises.
    """
    if not target.is_traced:
        return functools.partial(_check_plain, target)

    @jax.jit
    def check(*arrays):
        if target.has_gradient:
            outputs, pull_back = jax.vjp(target.function, *arrays)
            gradients = pull_back(jax.tree.map(_alternate, outputs))
        else:
            outputs, gradients = target.function(*arrays), ()
        found = {"finite": _are_finite(outputs)}
        for place, gradient in enumerate(gradients):
            found[f"gradient of input {place}"] = _are_finite(gradient)
        return found | {"its promise": target.holds(outputs, *arrays)}

    return lambda *arrays: jax.device_get(check(*arrays))


def _check_plain(target, *arrays):
    try:
        outputs = target.function(*arrays)
    except ValueError as error:
        # "<Subject> must be <expected>, but <what came>; <what to do>."
        says_all = ", but " in str(error) and "; " in str(error)
        return {"refused in a sentence": says_all}
    leaves = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(outputs)]
    found = {"finite": all(np.isfinite(leaf).all() for leaf in leaves)}
    return found | {"its promise": target.holds(outputs, *arrays)}


def _are_finite(tree):
    leaves = jax.tree.leaves(tree)
    return jnp.all(jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def _alternate(output):
    """Cotangents 1, -1, 1, ...: no cell's gradient can hide behind another's."""
    size = output.size
    return (1 - 2 * (jnp.arange(size) % 2)).reshape(output.shape).astype(output.dtype)
