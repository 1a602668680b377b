"""What a training step costs: python -m dpc_jax.measure.step_profile

It times the parts of a step of configs/car.py, each compiled alone, and the whole step,
at several steps of the run, and prints a Markdown table of medians in milliseconds of
processor time. For one thread, which docs/profile.md shows, start it as

    XLA_FLAGS=--xla_cpu_multi_thread_eigen=false taskset -c 1 python -m ...
"""

import argparse
import statistics
import sys
import time
from collections.abc import Sequence

from dpc_jax.config import Config, build_config
from dpc_jax.measure.step_parts import make_calls
from dpc_jax.measure.timing import describe_machine, phrase_machine, time_interleaved
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.process import keep_freed_memory

CAR = {  # as in configs/car.py
    "render": {"num_points": 4000, "keep_end": 0.5},
    "network": {"shape_hidden": 256},
    "train": {"repulsion_weight": 8.0},
}
PARTS = (  # rows of the table
    *("whole step", "encoder", "other layers", "optimiser", "point dropout"),
    *("half turns", "ranking of candidates", "exact comparison", "winners"),
    *("common frame", "pull", "priors", "targets"),
)


def measure_step(config: Config, step: int, *, rounds: int) -> dict[str, float]:
    """Median milliseconds of each part, at the step with this number."""
    calls = make_calls(config, step)
    seconds = time_interleaved(calls, rounds=rounds, clock=time.process_time)
    parts = {name: 1e3 * statistics.median(times) for name, times in seconds.items()}
    parts["exact comparison"] = parts.pop("choice") - parts["ranking of candidates"]
    return parts


def can_measure(config: Config, steps: Sequence[int], *, rounds: int) -> bool:
    """Whether the run has these steps, and there is a round; says so where not."""
    if rounds >= 1 and all(0 <= step < config.train.steps for step in steps):
        return True
    print(
        f"Error: Expected steps from 0 to {config.train.steps - 1} and at least one "
        f"round, but {list(steps)} and {rounds} came; give others.",
        file=sys.stderr,
    )
    return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--steps", type=int, nargs="+", default=[0, 3000, 3900, 5500])
    parser.add_argument("--rounds", type=int, default=15)
    flags = parser.parse_args(arguments)
    keep_freed_memory()
    config = build_config("car", None, CAR)
    if not can_measure(config, flags.steps, rounds=flags.rounds):
        return 1
    columns = [measure_step(config, s, rounds=flags.rounds) for s in flags.steps]
    heads = ("ms", *(f"step {step}" for step in flags.steps))
    rows = [(name, *(f"{column[name]:.1f}" for column in columns)) for name in PARTS]
    print(phrase_machine(describe_machine()), end=".\n\n")
    print(format_table(heads, rows, align="l" + "r" * len(columns)), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
