"""One run of the benchmark: its parts in turn, then the report."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.learning.progress import ProgressReport
from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, peak, report, scaling, speed
from dpc_jax.measure.benchmark.plan import PARTS, Plan
from dpc_jax.measure.timing import describe_machine


def run_benchmark(
    out: Path, *, plan: Plan, parts: Sequence[str] = PARTS, command: str = ""
) -> Path:
    """Measure the parts asked for and write OUT/benchmark.md, .json and figures.

    Args:
      out: folder, made where it is missing.
      plan: sizes. parts: any of `PARTS`. command: that repeats the run, for the report.

    Returns:
      The path of benchmark.md.

    Raises:
      ValueError: for an unknown part, or none.
      RuntimeError: where a process of the memory part fails; the parts before it are
        written.
      OSError: where the folder cannot be written.
    """
    unknown = sorted(set(parts) - set(PARTS))
    if unknown or not parts:
        raise ValueError(
            f"parts must be some of {', '.join(PARTS)}, but "
            f"{', '.join(unknown) or 'none'} came; write for example --parts=speed."
        )
    out.mkdir(parents=True, exist_ok=True)
    tasks = [
        (part, name, task)
        for part in PARTS
        if part in parts
        for name, task in _TASKS[part](plan)
    ]
    results: dict[str, Any] = {"machine": describe_machine(), "command": command}
    results |= {"has_torch": speed.has_torch(), "seed": plan.seed}
    results |= {"reference_side": plan.reference_side, "base_side": plan.base_side}
    try:
        with ProgressReport("Benchmark", total=len(tasks)) as progress:
            for step, (part, name, task) in enumerate(tasks, start=1):
                progress.tell(f"{step}/{len(tasks)} {part}: {name}")
                results.setdefault(part, []).extend(task())
                progress.advance(step)
    except BaseException:
        # The parts before the one that failed, or was interrupted, took minutes.
        results.pop(part, None)
        if any(name in results for name in PARTS):
            report.write_report(out, results)
        raise
    return report.write_report(out, results)


Task = tuple[str, Callable[[], list[dict]]]


def _list_speed(plan) -> list[Task]:
    clock = {"rounds": plan.rounds, "seed": plan.seed}

    def compare(kind, function, case, **options):
        return f"{kind}, {case}", lambda: [
            {"kind": kind} | function(case, **options, **clock)
        ]

    tasks = [compare("peers", speed.compare_with_peers, case) for case in plan.cases]
    tasks.append(compare("sizes", speed.compare_sizes, plan.per_point))
    tasks.append(
        compare(
            "choices",
            speed.compare_choices,
            plan.candidates,
            num_candidates=plan.num_candidates,
        )
    )
    return tasks


def _list_error(plan) -> list[Task]:
    settings = accuracy.list_settings(plan)
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=plan.seed
    )

    def measure(scene, sigma):
        return (
            f"{scene.name}, σ={sigma:g}",
            lambda: accuracy.measure_scene(scene, sigma, plan=plan, settings=settings),
        )

    return [measure(scene, sigma) for scene in made for sigma in plan.sigmas]


def _list_scaling(plan) -> list[Task]:
    def measure(axis):
        return axis, lambda: [scaling.measure_axis(axis, plan=plan)]

    return [measure(axis) for axis in scaling.AXES]


def _list_memory(plan) -> list[Task]:
    def measure(case):
        return (
            f"{case.method}, {case.case}",
            lambda: [peak.measure_case(case, seed=plan.seed)],
        )

    return [measure(case) for case in plan.memory]


_TASKS = {
    "speed": _list_speed,
    "error": _list_error,
    "scaling": _list_scaling,
    "memory": _list_memory,
}
