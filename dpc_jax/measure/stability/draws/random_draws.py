"""The part of the report on random draws: the whole float range, every function."""

import dataclasses
import importlib.util
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dpc_jax.measure.stability.draws import learning_targets, render_targets
from dpc_jax.measure.stability.draws.targets import Range, Target, make_check
from dpc_jax.measure.stability.report_parts import Order, PartResult

DRAWS, QUICK_DRAWS = 10_000, 30


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a target.

    Attributes:
      target: its name. limit: the range drawn from, where not all finite numbers.
      draws: how many were tried.
      broken: properties that did not hold for the smallest draw that breaks one.
      inputs: that draw, as text; both empty where all held.
    """

    target: str
    limit: str
    draws: int
    broken: tuple[str, ...] = ()
    inputs: str = ""


class _Broken(Exception):
    """A draw broke a property; carries what an `Outcome` holds of it."""


def run_part(order: Order) -> PartResult:
    """The part in full; see `parts.run_part`."""
    return run(order.out, quick=False, seed=order.seed, tell=order.tell)


def run(
    out: Path,
    *,
    quick: bool,
    seed: int = 0,
    draws: int | None = None,
    targets: Sequence[Target] | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> PartResult:
    """Draw inputs for every function; writes no file.

    Args:
      quick: 30 draws of each function, else 10,000.
      seed: of all draws; the same seed draws the same.
      draws: another number of them.
      targets: some functions; None for all.
      tell: shows a line of text for each function that is done.
    """
    del out  # a table says it all
    if importlib.util.find_spec("hypothesis") is None:
        sentence = (
            "random draws need hypothesis, which is not installed; install the extra "
            "test (pip install 'dpc_jax[test]') or leave this part out."
        )
        return PartResult(
            f"## Random draws\n\nNot run: {sentence}\n", None, False, (sentence,)
        )
    count = draws or (QUICK_DRAWS if quick else DRAWS)
    outcomes = []
    for target in list_targets() if targets is None else targets:
        outcomes.append(draw_inputs(target, draws=count, seed=seed))
        state = "broken" if outcomes[-1].broken else "holds"
        tell(f"random, {target.name}: {outcomes[-1].draws} draws, {state}")
    failures = tuple(
        f"random draws, {o.target}: {', '.join(o.broken)} did not hold for {o.inputs}."
        for o in outcomes
        if o.broken
    )
    return PartResult(
        markdown=write_section(outcomes),
        data=[dataclasses.asdict(o) for o in outcomes],
        passes=not failures,
        failures=failures,
    )


def list_targets() -> list[Target]:
    """All functions that draws are thrown at."""
    return [*render_targets.list_targets(), *learning_targets.list_targets()]


def draw_inputs(target: Target, *, draws: int, seed: int) -> Outcome:
    """Throw draws at a target until one breaks it, and make that one small."""
    import hypothesis
    from hypothesis import strategies

    check = make_check(target)
    counter = itertools.count()

    # No data base and a fixed seed: the same draws at every run.
    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=draws,
        deadline=None,
        database=None,
        derandomize=False,
        report_multiple_bugs=False,
        verbosity=hypothesis.Verbosity.quiet,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(strategies.tuples(*(_draw_array(r) for r in target.inputs)))
    def judge(arrays):
        next(counter)
        try:
            found = check(*arrays)
        except Exception as error:  # an undocumented one is what is looked for
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
    """A strategy of arrays: of ordinary numbers, of any, or of both."""
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


def write_section(outcomes: Sequence[Outcome]) -> str:
    """Section of the report: what broke, then draws and ranges."""
    lines = ["## Random draws", ""]
    broken = [o for o in outcomes if o.broken]
    for o in broken:
        lines += [f"**{o.target}**: {', '.join(o.broken)} for `{o.inputs}`", ""]
    lines += [
        f"{sum(o.draws for o in outcomes)} draws of float32 numbers, subnormal ones, "
        "zeros of both signs and the largest among them, mixed with ordinary ones. For "
        "each draw values and gradients to every input must be finite, and what the "
        "function promises (silhouettes and occupancies in [0, 1], probabilities not "
        "negative with sum 1, unit quaternions) must hold. A documented refusal "
        "counts as an answer.",
        "",
        "| function | draws | holds | limits of what is drawn |",
        "|---|---:|---|---|",
    ]
    for o in outcomes:
        state = "**no**" if o.broken else "yes"
        limit = o.limit.replace("|", "\\|") or "none"
        lines.append(f"| {o.target} | {o.draws} | {state} | {limit} |")
    return "\n".join(lines) + "\n"
