"""One run of the benchmark: its parts in turn, then the report."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from dpc_jax.learning.training.progress import ProgressReport
from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, pytorch, report, speed
from dpc_jax.measure.benchmark.plan import PARTS, SEED, Plan
from dpc_jax.measure.timing import describe_machine

# A part, what is measured, and the call that gives its record, or several.
Task = tuple[str, str, Callable[[], dict | list[dict]]]


def run_benchmark(out: Path, *, plan: Plan, parts: Sequence[str], command: str) -> Path:
    """Measure some of `PARTS` and write OUT/benchmark.md, .json and figures.

    Returns the path of benchmark.md, which names the command that repeats the run.

    Raises:
      OSError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {
        "machine": describe_machine(),
        "command": command,
        "has_torch": pytorch.has_torch(),
        "seed": SEED,
        "reference_side": plan.reference_side,
        "base_side": plan.base_side,
    }
    try:
        _run_tasks([task for task in list_tasks(plan) if task[0] in parts], results)
    finally:  # finished parts took minutes: keep them
        if results.keys() & set(PARTS):
            report.write_report(out, results)
    return out / "benchmark.md"


def _run_tasks(tasks: Sequence[Task], results: dict[str, Any]) -> None:
    """Add the records of each part to the results once the whole part is measured."""
    with ProgressReport("Benchmark", total=len(tasks)) as progress:
        records: dict[str, list[dict]] = {}
        for step, (part, name, measure) in enumerate(tasks, start=1):
            progress.tell(f"{step}/{len(tasks)} {part}: {name}")
            found = measure()
            records.setdefault(part, []).extend(
                [found] if isinstance(found, dict) else found
            )
            progress.advance(step)
            if step == len(tasks) or tasks[step][0] != part:
                results[part] = records[part]


def list_tasks(plan: Plan) -> Iterator[Task]:
    """What a plan measures, in the order of `PARTS`."""
    turns = {"rounds": plan.rounds}
    for case in plan.cases:
        call = partial(speed.compare_with_peers, case, **turns)
        yield "speed", f"peers, {case}", call
    call = partial(speed.compare_sizes, plan.sized, **turns)
    yield "speed", "a sigma per point", call
    for case, signals in plan.sizes:
        call = partial(speed.compare_volumes, case, signals, **turns)
        yield "sizes", f"{'+'.join(signals)}, {case}", call
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=SEED
    )
    fixed = {"plan": plan, "settings": accuracy.list_settings(plan)}
    for scene, sigma in itertools.product(made, plan.sigmas):
        call = partial(accuracy.measure_scene, scene, sigma, **fixed)
        yield "error", f"{scene.name}, σ={sigma:g}", call
