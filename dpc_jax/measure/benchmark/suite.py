"""One run of the benchmark: its parts in turn, then the report."""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.learning.training.progress import ProgressReport
from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, peak, peers, report, sizes, speed
from dpc_jax.measure.benchmark.plan import PARTS, Plan
from dpc_jax.measure.timing import describe_machine

# A part, what is measured, and the call that gives its records.
Task = tuple[str, str, Callable[[], list[dict]]]


def run_benchmark(out: Path, *, plan: Plan, parts: Sequence[str], command: str) -> Path:
    """Measure some of `PARTS` and write OUT/benchmark.md, .json and figures.

    Returns the path of benchmark.md, which names the command that repeats the run.

    Raises:
      RuntimeError: a process of the memory part fails; finished parts are written.
      OSError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {
        "machine": describe_machine(),
        "command": command,
        "has_torch": peers.has_torch(),
        "seed": plan.seed,
        "reference_side": plan.reference_side,
        "base_side": plan.base_side,
    }
    try:
        _run_tasks(plan, parts, results)
    except BaseException:
        # The finished parts took minutes: keep them.
        if any(part in results for part in PARTS):
            report.write_report(out, results)
        raise
    return report.write_report(out, results)


def _run_tasks(plan: Plan, parts: Sequence[str], results: dict[str, Any]) -> None:
    """Add the records of each part to the results once the whole part is measured."""
    tasks = [task for task in list_tasks(plan) if task[0] in parts]
    with ProgressReport("Benchmark", total=len(tasks)) as progress:
        records: dict[str, list[dict]] = {}
        for step, (part, name, measure) in enumerate(tasks, start=1):
            progress.tell(f"{step}/{len(tasks)} {part}: {name}")
            records.setdefault(part, []).extend(measure())
            progress.advance(step)
            if step == len(tasks) or tasks[step][0] != part:
                results[part] = records[part]


def list_tasks(plan: Plan) -> Iterator[Task]:
    """What a plan measures, in the order of `PARTS`."""
    shared = {"rounds": plan.rounds, "seed": plan.seed}
    for case in plan.cases:
        yield "speed", f"peers, {case}", _one(speed.compare_with_peers, case, **shared)
    case, count = plan.candidates, {"num_candidates": plan.num_candidates}
    call = _one(speed.compare_choices, case, **shared, **count)
    yield "speed", f"choices, {case}", call
    yield "speed", "a sigma per point", _one(speed.compare_sizes, plan.sized, **shared)
    for case, signals in plan.sizes:
        call = _one(sizes.compare_volumes, case, signals, **shared)
        yield "sizes", f"{'+'.join(signals)}, {case}", call
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=plan.seed
    )
    fixed = {"plan": plan, "settings": accuracy.list_settings(plan)}
    for scene, sigma in itertools.product(made, plan.sigmas):
        call = functools.partial(accuracy.measure_scene, scene, sigma, **fixed)
        yield "error", f"{scene.name}, σ={sigma:g}", call
    for axis in speed.AXES:
        yield "scaling", axis, _one(speed.measure_axis, axis, plan=plan)
    for case in plan.memory:
        call = _one(peak.measure_case, case, seed=plan.seed)
        yield "memory", f"{case.method}, {case.case}", call


def _one(function, *arguments, **options):
    """A call that gives its one record as a list."""
    return lambda: [function(*arguments, **options)]
