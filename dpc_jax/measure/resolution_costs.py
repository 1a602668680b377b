"""What a step costs by resolution: python -m dpc_jax.measure.resolution_costs

It takes training steps with known poses of point clouds and of voxel models at 32, 64
and 128, each in a process of its own and on one thread, and writes their seconds and
memory as resolution_costs.json and as a figure: whether voxels scale (§ Estimating
shape with known pose).
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from dpc_jax.config import build_config
from dpc_jax.files import write_json
from dpc_jax.learning import schedules
from dpc_jax.learning.step import init_state, make_train_step, repeat_seed
from dpc_jax.measure.step_parts import draw_batch
from dpc_jax.measure.timing import describe_machine, phrase_machine
from dpc_jax.reporting import style
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.memory import estimate_step_memory
from dpc_jax.run.setup import make_network

MODELS = {"points": "known_pose", "voxels": "known_pose,ours_v"}
SIDES = (32, 64, 128)
_ONE_THREAD = "--xla_cpu_multi_thread_eigen=false"


def measure_one(model: str, side: int, *, steps: int) -> dict[str, Any]:
    """Costs of a model's step at the end of its run, in this process.

    Args:
      model: of `MODELS`. side: of images and volume. steps: that are timed.

    Returns:
      seconds (median, of the processor) and seconds_all of each step; memory_gb, the
      process's peak; estimated_gb of the step's arrays; parameters.
    """
    config = build_config("chair", f"{MODELS[model]},{side}")
    network = make_network(config)
    state = init_state(network, config)
    batch = draw_batch(config)
    batch["seeds"] = repeat_seed(config.seed, config.train.models_per_batch)
    last = schedules.find_stage(
        config.train.steps - 1, config.render, steps=config.train.steps
    )
    step = make_train_step(network, config, last)
    taken = []
    for _ in range(steps + 1):  # the first one compiles
        started = time.process_time()
        state, metrics = step(state, batch)
        jax.block_until_ready(metrics)
        taken.append(time.process_time() - started)
    sizes = [leaf.size for leaf in jax.tree.leaves(state.params)]
    return {
        "model": model,
        "side": side,
        "seconds": statistics.median(taken[1:]),
        "seconds_all": taken[1:],
        # Linux gives kilobytes.
        "memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "estimated_gb": estimate_step_memory(network, config) / 2**30,
        "parameters": sum(sizes),
    }


def measure_all(sides: Sequence[int], *, steps: int) -> list[dict[str, Any]]:
    """Costs of both models at these sides, each in a process of its own.

    One that fails, for lack of memory, has its problem and no costs.
    """
    found = []
    for side in sides:
        for model in MODELS:
            print(f"{model}, {side}: measuring", flush=True)
            command = [sys.executable, "-m", "dpc_jax.measure.resolution_costs"]
            flags = [f"--one={model}", f"--sides={side}", f"--steps={steps}"]
            own = os.environ | {"XLA_FLAGS": _ONE_THREAD, "JAX_PLATFORMS": "cpu"}
            done = subprocess.run(
                [*command, *flags], env=own, capture_output=True, text=True
            )
            try:
                found.append(json.loads(done.stdout.splitlines()[-1]))
            except (ValueError, IndexError):
                lines = done.stderr.strip().splitlines() or [
                    f"it ended with status {done.returncode}"
                ]
                problem = {"model": model, "side": side, "problem": lines[-1]}
                print(f"{model}, {side}: {problem['problem']}", flush=True)
                found.append(problem)
    return found


def draw_costs(costs: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Seconds of a step and peak memory over the side, a line for each model."""
    figure = style.make_figure(7.6, 3.4)
    panels = style.make_panels(figure, 2, columns=2)
    shown = (
        ("seconds", "Time of a training step", "seconds of one core"),
        ("memory_gb", "Peak memory of the process", "GB"),
    )
    for axes, (name, title, label) in zip(panels, shown, strict=True):
        for model, color in zip(MODELS, style.SERIES, strict=False):
            own = [c for c in costs if c["model"] == model and name in c]
            places = [c["side"] for c in own], [c[name] for c in own]
            axes.plot(*places, "o-", color=color, label=model)
        style.label_axes(
            axes, title=title, x_label="side of images and volume", y_label=label
        )
        axes.set_xscale("log")
        if name == "seconds":
            axes.set_yscale("log")
        else:
            axes.set_ylim(bottom=0.0)
        style.set_ticks(axes, sorted({c["side"] for c in costs}))
    panels[0].legend(frameon=False, fontsize=8)
    return style.save_figure(figure, path)


def format_costs(costs: Sequence[Mapping[str, Any]]) -> str:
    """The costs as a Markdown table."""
    heads = (
        "Model",
        "Side",
        "ms per step",
        "Peak memory (GB)",
        "Arrays of a step (GB)",
    )
    rows = [
        (
            c["model"],
            str(c["side"]),
            f"{1e3 * c['seconds']:.0f}",
            f"{c['memory_gb']:.2f}",
            f"{c['estimated_gb']:.2f}",
        )
        for c in costs
        if "seconds" in c
    ]
    return format_table(heads, rows, align="lrrrr")


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, write."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("."), help="folder, default .")
    parser.add_argument("--sides", type=int, nargs="+", default=list(SIDES))
    parser.add_argument("--steps", type=int, default=5, help="timed, default 5")
    parser.add_argument("--one", choices=tuple(MODELS), help=argparse.SUPPRESS)
    flags = parser.parse_args(arguments)
    wrong = [side for side in flags.sides if side not in SIDES]
    if wrong or flags.steps < 1:
        print(
            f"Error: Expected sides of {list(SIDES)} and at least one step, but "
            f"{flags.sides} and {flags.steps} came; give others.",
            file=sys.stderr,
        )
        return 1
    if flags.one:
        print(json.dumps(measure_one(flags.one, flags.sides[0], steps=flags.steps)))
        return 0
    flags.out.mkdir(parents=True, exist_ok=True)
    costs = measure_all(flags.sides, steps=flags.steps)
    machine = describe_machine()
    record = {"machine": machine, "costs": costs}
    write_json(flags.out / "resolution_costs.json", record)
    picture = draw_costs(costs, flags.out / "resolution_costs.png")
    print(phrase_machine(machine), end=".\n\n")
    print(format_costs(costs), end="")
    print(f"Picture: {picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
