"""The part of the report on random draws: every function over all float32 numbers.

Only this part needs `hypothesis`, an extra of the package: it is imported where it is
used, so that the rest of the package runs without it.
"""

import dataclasses
import importlib.util
import itertools
from collections.abc import Sequence

import numpy as np

from dpc_jax.measure.stability.draws import learning_targets, render_targets
from dpc_jax.measure.stability.draws.targets import Range, Target, make_check
from dpc_jax.measure.stability.report_parts import (
    PartRequest,
    PartResult,
    start_section,
)
from dpc_jax.reporting.tables import format_table

TITLE = "Random draws"
DRAWS, QUICK_DRAWS = 10_000, 30
MISSING = (
    "Random draws need the library hypothesis, but it is not installed; install it "
    "with pip install 'dpc_jax[test]', or leave this part out."
)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a target."""

    target: str  # its name
    limit: str  # the range drawn from, if it is not all finite numbers
    draws: int  # how many were tried
    broken: tuple[str, ...] = ()  # the properties that one draw broke
    inputs: str = ""  # that draw, made as simple as it can be while it breaks them


class _Broken(Exception):
    """A draw broke a property; its arguments are the properties and the draw."""


def run_part(
    request: PartRequest,
    *,
    draws: int | None = None,
    targets: Sequence[Target] | None = None,
) -> PartResult:
    """Draw inputs for every function; writes no file.

    The quick form makes 30 draws for each function, the full one 10,000. The same seed
    makes the same draws.
    """
    if importlib.util.find_spec("hypothesis") is None:
        section = [*start_section(TITLE), f"Not run. {MISSING}", ""]
        return PartResult("\n".join(section), None, (MISSING,))
    count = draws or (QUICK_DRAWS if request.quick else DRAWS)
    outcomes = []
    for target in list_targets() if targets is None else targets:
        outcomes.append(draw_inputs(target, draws=count, seed=request.seed))
        state = "broken" if outcomes[-1].broken else "holds"
        request.tell(f"random, {target.name}: {outcomes[-1].draws} draws, {state}")
    failures = tuple(
        f"random draws, {o.target}: {', '.join(o.broken)} did not hold for {o.inputs}."
        for o in outcomes
        if o.broken
    )
    data = [dataclasses.asdict(o) for o in outcomes]
    return PartResult(_write_section(outcomes), data, failures)


def list_targets() -> list[Target]:
    """All functions that inputs are drawn for."""
    return [*render_targets.list_targets(), *learning_targets.list_targets()]


def draw_inputs(target: Target, *, draws: int, seed: int) -> Outcome:
    """Try draws on a target until one breaks it, and simplify that one."""
    import hypothesis
    from hypothesis import strategies

    check = make_check(target)
    counter = itertools.count()

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
        next(counter)
        try:
            found = check(*arrays)
        except Exception as error:  # any exception that is not documented is a find
            raise _Broken((f"{type(error).__name__}: {error}",), arrays) from error
        broken = tuple(name for name, holds in found.items() if not holds)
        if broken:
            raise _Broken(broken, arrays)

    broken, inputs = (), ""
    try:
        judge()
    except _Broken as error:
        broken, arrays = error.args
        inputs = "; ".join(str(a.tolist()) for a in arrays)
    return Outcome(target.name, target.limit, next(counter), broken, inputs)


def _draw_array(wanted: Range):
    """A strategy of arrays of ordinary numbers, alone or mixed with extreme ones."""
    from hypothesis import strategies
    from hypothesis.extra import numpy as arrays

    if wanted.kind == "byte":
        return arrays.arrays(np.uint8, wanted.shape)

    def make_elements(low, high):
        low, high = float(np.float32(low)), float(np.float32(high))
        numbers = strategies.floats(low, high, width=32)
        if wanted.smallest:
            floor = wanted.smallest
            numbers = numbers.map(lambda x: x if abs(x) >= floor else 0.0)
        return numbers

    usual = make_elements(*wanted.usual)
    either = strategies.one_of(usual, make_elements(wanted.low, wanted.high))
    return strategies.one_of(
        arrays.arrays(np.float32, wanted.shape, elements=either),
        arrays.arrays(np.float32, wanted.shape, elements=usual),
    )


def _write_section(outcomes):
    lines = start_section(TITLE)
    for o in outcomes:
        if o.broken:
            lines += [f"**{o.target}**: {', '.join(o.broken)} for `{o.inputs}`", ""]
    rows = [
        (o.target, o.draws, "**no**" if o.broken else "yes", o.limit or "none")
        for o in outcomes
    ]
    lines += [
        f"{sum(o.draws for o in outcomes)} draws of float32 numbers, subnormal ones, "
        "zeros of both signs and the largest among them, mixed with ordinary ones. For "
        "each draw values and gradients to every input must be finite, and what the "
        "function promises (silhouettes and occupancies in [0, 1], probabilities not "
        "negative with sum 1, unit quaternions) must hold. A documented refusal "
        "counts as an answer.",
        "",
        format_table(("function", "draws", "holds", "limits of what is drawn"), rows),
    ]
    return "\n".join(lines)
