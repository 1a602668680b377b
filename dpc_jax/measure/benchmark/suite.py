"""One run of the benchmark: its parts in turn, then the report."""

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from dpc_jax.learning.training.progress import ProgressReport
from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, pytorch, report, speed
from dpc_jax.measure.benchmark.plan import PARTS, SEED, Plan
from dpc_jax.measure.timing import describe_machine

# What is measured, and the call that gives its record, or several.
Task = tuple[str, Callable[[], dict | list[dict]]]


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
    tasks = {part: list_tasks(part, plan) for part in PARTS if part in parts}
    total = sum(map(len, tasks.values()))
    with ProgressReport("Benchmark", total=total) as progress:
        step = 0
        for part, measures in tasks.items():
            records = []
            for name, measure in measures:
                step += 1
                progress.tell(f"{step}/{total} {part}: {name}")
                found = measure()
                records += [found] if isinstance(found, dict) else found
                progress.advance(step)
            results[part] = records
            report.write_report(out, results)  # parts take minutes: keep each
    return out / "benchmark.md"


def list_tasks(part: str, plan: Plan) -> list[Task]:
    """What a part of a plan measures."""
    turns = {"rounds": plan.rounds}
    if part == "speed":
        peers = speed.compare_with_peers
        tasks = [(str(case), partial(peers, case, **turns)) for case in plan.cases]
        sizes = partial(speed.compare_sizes, plan.sized, **turns)
        return [*tasks, ("a sigma per point", sizes)]
    if part == "sizes":
        return [
            (
                f"{'+'.join(signals)}, {case}",
                partial(speed.compare_volumes, case, signals, **turns),
            )
            for case, signals in plan.sizes
        ]
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=SEED
    )
    settings = [
        accuracy.Setting(*family, side)
        for side in plan.sides
        for family in accuracy.FAMILIES
    ]
    fixed = {"plan": plan, "settings": settings}
    return [
        (
            f"{scene.name}, σ={sigma:g}",
            partial(accuracy.measure_scene, scene, sigma, **fixed),
        )
        for scene, sigma in itertools.product(made, plan.sigmas)
    ]
