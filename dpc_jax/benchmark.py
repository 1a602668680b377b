"""Error against run time: python -m dpc_jax.benchmark [--quick] [--out=DIR]

Measures speed beside PyTorch, how time and memory grow with points and grid, and the
error of every setting; writes benchmark.md, benchmark.json and a figure into DIR. It
judges nothing.
"""

import argparse
import contextlib
import itertools
import shlex
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from dpc_jax.measure.benchmark.plan import FULL, PARTS, QUICK, SEED, Plan
from dpc_jax.task import FlagParser, Task, reading_names, run_command

WRITES = ("benchmark.md", "benchmark.json", "error.png")


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("benchmark", description="Error against run time.")
    add = parser.add_argument
    text = "tiny sizes, to check that all works"
    add("--quick", action="store_true", help=text)
    add("--out", type=Path, default=Path("runs/benchmark"), help="folder (%(default)s)")
    text = f"some of {','.join(PARTS)}; default: all"
    add("--parts", type=reading_names(PARTS), default=PARTS, help=text)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, measure, write the report; returns the exit status."""
    return run_command(lambda: _read(arguments))


def _read(arguments):
    words = sys.argv[1:] if arguments is None else arguments
    options = make_parser().parse_args(words)
    command = shlex.join(["python", "-m", "dpc_jax.benchmark", *words])
    return Task(
        lambda: _measure(options, command),
        out=options.out,
        interrupted=f"Interrupted; finished parts are in {options.out}.",
        writes=WRITES,
        # XLA tells of memory that is not there by a RuntimeError.
        errors=(ValueError, OSError, RuntimeError),
    )


def list_tasks(
    part: str, plan: Plan
) -> list[tuple[str, Callable[[], dict | list[dict]]]]:
    """What a part measures, by name, and the call that gives its record, or several."""
    # Heavy: flags are read first.
    from dpc_jax.measure import scenes
    from dpc_jax.measure.benchmark import accuracy, speed

    turns = {"rounds": plan.rounds}
    if part == "speed":
        peers = speed.compare_with_peers
        return [(str(case), partial(peers, case, **turns)) for case in plan.cases]
    if part == "sizes":
        volumes = partial(speed.compare_volumes, **turns)
        return [
            (f"{'+'.join(signals)}, {case}", partial(volumes, case, signals))
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
    errors = partial(accuracy.measure_scene, plan=plan, settings=settings)
    return [
        (f"{scene.name}, σ={sigma:g}", partial(errors, scene, sigma))
        for scene, sigma in itertools.product(made, plan.sigmas)
    ]


def _measure(options, command):
    """Measure part by part, and write the report after each: parts take minutes."""
    # Heavy, as above.
    from dpc_jax.measure.benchmark import pytorch, report
    from dpc_jax.measure.timing import describe_machine
    from dpc_jax.render import use_all_cores
    from dpc_jax.run.process import keep_freed_memory

    with contextlib.suppress(RuntimeError):  # a program of the caller's has begun
        use_all_cores()
    keep_freed_memory()
    options.out.mkdir(parents=True, exist_ok=True)
    plan = QUICK if options.quick else FULL
    results = {
        "machine": describe_machine(),
        "command": command,
        "has_torch": pytorch.has_torch(),
        "seed": SEED,
        "reference_side": plan.reference_side,
        "base_side": plan.base_side,
    }
    tasks = {p: list_tasks(p, plan) for p in PARTS if p in options.parts}
    step, total = 0, sum(map(len, tasks.values()))
    for part, measures in tasks.items():
        records = []
        for name, measure in measures:
            step += 1
            print(f"{step}/{total} {part}: {name}", flush=True)
            found = measure()
            records += [found] if isinstance(found, dict) else found
        results[part] = records
        report.write_report(options.out, results)
    print(f"Report: {options.out / 'benchmark.md'}")


if __name__ == "__main__":
    sys.exit(main())
