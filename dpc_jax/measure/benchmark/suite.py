"""One run of the benchmark: its parts in turn, then the report."""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.learning.training.progress import ProgressReport
from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, peak, report, scaling, solids, speed
from dpc_jax.measure.benchmark.plan import PARTS, Plan
from dpc_jax.measure.timing import describe_machine


def run_benchmark(out: Path, *, plan: Plan, parts: Sequence[str], command: str) -> Path:
    """Measure the parts asked for and write OUT/benchmark.md, .json and figures.

    Returns the path of benchmark.md, which names the command that repeats the run.

    Raises:
      ValueError: there is an unknown part, or no part.
      RuntimeError: a process of the memory part fails; finished parts are written.
      OSError: the folder cannot be written.
    """
    unknown = sorted(set(parts) - set(PARTS))
    if unknown or not parts:
        raise ValueError(
            f"parts must be some of {', '.join(PARTS)}, but "
            f"{', '.join(unknown) or 'none'} came; write for example --parts=speed."
        )
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {
        "machine": describe_machine(),
        "command": command,
        "has_torch": speed.has_torch(),
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
    tasks = {part: _TASKS[part](plan) for part in PARTS if part in parts}
    total, step = sum(map(len, tasks.values())), 0
    with ProgressReport("Benchmark", total=total) as progress:
        for part, list_of_part in tasks.items():
            records = []
            for name, task in list_of_part:
                step += 1
                progress.tell(f"{step}/{total} {part}: {name}")
                records += task()
                progress.advance(step)
            results[part] = records


Task = tuple[str, Callable[[], list[dict]]]


def _list_speed(plan) -> list[Task]:
    """Each kind of comparison with its function, case and further arguments."""
    count = {"num_candidates": plan.num_candidates}
    wanted = [
        *(("peers", speed.compare_with_peers, case, {}) for case in plan.cases),
        ("sizes", speed.compare_sizes, plan.cases[0], {}),
        ("choices", speed.compare_choices, plan.candidates, count),
    ]

    def compare(kind, function, case, options):
        record = function(case, rounds=plan.rounds, seed=plan.seed, **options)
        return [{"kind": kind} | record]

    return [(f"{row[0]}, {row[2]}", functools.partial(compare, *row)) for row in wanted]


def _list_error(plan) -> list[Task]:
    measure = functools.partial(
        accuracy.measure_scene, plan=plan, settings=accuracy.list_settings(plan)
    )
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=plan.seed
    )
    return [
        (f"{scene.name}, σ={sigma:g}", functools.partial(measure, scene, sigma))
        for scene in made
        for sigma in plan.sigmas
    ]


def _list_solids(plan) -> list[Task]:
    return [("an ellipsoid", lambda: solids.measure_solids(plan))]


def _list_scaling(plan) -> list[Task]:
    return [
        (axis, lambda axis=axis: [scaling.measure_axis(axis, plan=plan)])
        for axis in scaling.AXES
    ]


def _list_memory(plan) -> list[Task]:
    def measure(case):
        return [peak.measure_case(case, seed=plan.seed)]

    return [
        (f"{case.method}, {case.case}", functools.partial(measure, case))
        for case in plan.memory
    ]


_TASKS = {
    "speed": _list_speed,
    "error": _list_error,
    "solids": _list_solids,
    "scaling": _list_scaling,
    "memory": _list_memory,
}
