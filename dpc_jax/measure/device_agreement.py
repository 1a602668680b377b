"""Whether a run has the same losses on several devices or processes.

    python -m dpc_jax.measure.device_agreement --precision=float64 --out=DIR
    python -m dpc_jax.measure.device_agreement --precision=float64 --out=DIR \
        --coordinator=127.0.0.1:7777 --processes=2 --process=I
        (for I = 0 and 1, after the first command)

In float32, sums in another order differ in their last digits; Adam carries that on, and
where two candidates explain a view alike, another one wins. In float64 nothing of this
is left: what differs there is not rounding.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.config import Config, build_config, replace_fields
from dpc_jax.data import DataSet
from dpc_jax.files import write_json
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.step import init_state, make_train_step
from dpc_jax.learning.training.loop import make_batch
from dpc_jax.measure.step_profile import CAR
from dpc_jax.reporting.tables import format_table
from dpc_jax.run import hosts
from dpc_jax.run.places import find_place
from dpc_jax.run.process import keep_freed_memory, split_cores
from dpc_jax.run.setup import load_sets, make_network

PRECISIONS = ("float32", "float64")


class Course(NamedTuple):
    """The first steps of a run.

    Attributes:
      losses: of each step.
      winners: of each step, by view; empty where poses are known.
    """

    losses: list[float]
    winners: list[list[int]]


def follow_run(config: Config, data: DataSet, *, steps: int, precision: str) -> Course:
    """The first steps of a run on its devices.

    Args:
      data: to train on.
      steps: how many, all of the first stage.
      precision: dtype of the parameters and of what is computed of them.
    """
    network = make_network(config)
    state = jax.tree.map(
        lambda leaf: leaf.astype(precision) if leaf.dtype == "float32" else leaf,
        init_state(network, config),
    )
    stage = schedules.find_stage(0, config.render, steps=config.train.steps)
    take_step = make_train_step(network, config, stage)
    course = Course([], [])
    for step in range(steps):
        state, metrics = take_step(state, make_batch(data, step, config))
        metrics = jax.device_get(metrics)
        course.losses.append(float(metrics["loss"]))
        course.winners.append(np.ravel(metrics.get("winners", ())).tolist())
    return course


def compare(found: Course, right: Course) -> tuple[float, int | None]:
    """The largest relative difference of a loss, and the first step of another winner.

    The latter is None where the same candidates won in all steps.
    """
    differences = np.abs(np.divide(found.losses, right.losses) - 1)
    pairs = zip(found.winners, right.winners, strict=True)
    others = (step for step, (ours, theirs) in enumerate(pairs) if ours != theirs)
    return float(differences.max()), next(others, None)


def _describe(name, found, right, reached):
    """Rows of the table: the same steps, more and more of them."""
    for count in reached:
        first = Course(*(rows[:count] for rows in found))
        difference, other = compare(first, Course(*(rows[:count] for rows in right)))
        told = "none" if other is None else f"step {other}"
        yield name, str(count), f"{difference:.0e}", told


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, train, and print what differs."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("device_agreement"))
    parser.add_argument("--variant", default="", help="of the config, such as 64")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--precision", choices=PRECISIONS, default="float32")
    parser.add_argument("--cache_dir", default="data", help="of the rendered cars")
    parser.add_argument("--coordinator", help="HOST:PORT of process 0 of a job")
    parser.add_argument("--processes", type=int)
    parser.add_argument("--process", type=int)
    flags = parser.parse_args(arguments)
    file = flags.out / f"device_agreement_{flags.precision}.json"
    try:
        place = find_place(flags.coordinator, flags.processes, flags.process)
        config = build_config("car", flags.variant, CAR)
        config = replace_fields(config, {"data": {"cache_dir": flags.cache_dir}})
        if place and not file.exists():
            raise ValueError(
                f"Expected the figures of one device in {file}, but there are none; "
                "run the same command without --coordinator first."
            )
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    jax.config.update("jax_enable_x64", flags.precision == "float64")
    split_cores(config.train.models_per_batch)
    keep_freed_memory()
    with hosts.joining(place) as job:
        data = load_sets(config)["train"]
        counts = [0] if place else list_counts(config)
        courses = [
            follow_run(
                replace_fields(config, {"run": {"devices": count}}),
                data,
                steps=flags.steps,
                precision=flags.precision,
            )
            for count in counts
        ]
        if place:
            right = Course(*json.loads(file.read_text(encoding="utf-8")))
            names = [f"{job.processes} processes"]
        else:
            right = courses[0]
            write_json(file, right)
            names = [f"{count} devices" for count in counts]
        reached = sorted({min(n, flags.steps) for n in (10, 20, 50, flags.steps)})
        rows = [
            row
            for name, course in zip(names, courses, strict=True)
            if course is not right
            for row in _describe(name, course, right, reached)
        ]
        heads = (f"{flags.precision}, against 1 device", "steps")
        heads = (*heads, "largest difference", "another winner")
        print(format_table(heads, rows, align="lrrr"), end="")
    return 0


def list_counts(config: Config) -> list[int]:
    """Numbers of devices that can share the objects of a batch."""
    most = devices.make_mesh(config).size
    return [n for n in range(1, most + 1) if config.train.models_per_batch % n == 0]


if __name__ == "__main__":
    sys.exit(main())
