"""What a training step costs: python -m dpc_jax.measure.step_profile [--variant=...]

Compiles the step of configs/car.py for several moments of a run, and prints a Markdown
table: what XLA says that it computes, reads and allocates, how long it took to compile,
and the median of the processor time of a step. For a number of one thread start it as

    XLA_FLAGS=--xla_cpu_multi_thread_eigen=false taskset -c 1 python -m ...
"""

import argparse
import runpy
import statistics
import sys
import time
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Config, from_config_dict, list_shipped
from dpc_jax.learning import schedules
from dpc_jax.learning.batches import repeat_seed
from dpc_jax.learning.step import init_state, make_train_step
from dpc_jax.measure.timing import describe_machine, phrase_machine
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.process import keep_freed_memory
from dpc_jax.run.setup import make_network


def _draw_batch(config) -> dict[str, jax.Array]:
    """A batch of random images and poses; each mask is a disc."""
    rng = np.random.default_rng(0)
    shape = config.train.models_per_batch, config.train.views_per_batch
    size = config.data.image_size
    place = np.linalg.norm(np.indices((size, size)) - (size - 1) / 2, axis=0)
    disc = np.where(place < size / 3, 255, 0).astype(np.uint8)
    poses = rng.normal(size=(*shape, 4)).astype(np.float32)
    batch = {
        "images": rng.integers(0, 256, (*shape, size, size, 3), np.uint8),
        "masks": np.broadcast_to(disc, (*shape, size, size)),
        "quaternions": poses / np.linalg.norm(poses, axis=-1, keepdims=True),
        "seeds": repeat_seed(0, shape[0]),
    }
    return {name: jnp.asarray(array) for name, array in batch.items()}


def measure_step(config: Config, step: int, *, rounds: int) -> dict[str, float]:
    """The columns of the table, by their heads, for the step with this number."""
    network = make_network(config)
    state = init_state(network, config)._replace(step=jnp.asarray(step, jnp.int32))
    batch = _draw_batch(config)
    stage = schedules.find_stage(step, config.render, steps=config.train.steps)
    begin = time.perf_counter()
    compiled = make_train_step(network, config, stage).lower(state, batch).compile()
    compile_seconds = time.perf_counter() - begin
    costs, memory = compiled.cost_analysis(), compiled.memory_analysis()
    seconds = []
    for _ in range(rounds):
        begin = time.process_time()
        # The old state's memory is given to the new one.
        state, _ = jax.block_until_ready(compiled(state, batch))
        seconds.append(time.process_time() - begin)
    return {
        "Gflop": costs["flops"] / 1e9,
        "read and written (MB)": costs["bytes accessed"] / 1e6,
        "arguments (MB)": memory.argument_size_in_bytes / 1e6,
        "temporary (MB)": memory.temp_size_in_bytes / 1e6,
        "compiled in (s)": compile_seconds,
        "processor time (ms)": 1e3 * statistics.median(seconds),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--variant", help="of the config, such as paper")
    parser.add_argument("--steps", type=int, nargs="+", default=[0, 3000, 3900, 5500])
    parser.add_argument("--rounds", type=int, default=15)
    flags = parser.parse_args(arguments)
    make = runpy.run_path(str(list_shipped()["car"]))["get_config"]
    config = from_config_dict(make(flags.variant))
    steps = range(config.train.steps)
    if not all(step in steps for step in flags.steps) or flags.rounds < 1:
        parser.error(
            f"Expected steps from 0 to {steps[-1]} and at least one round, but "
            f"{flags.steps} and {flags.rounds} came; give others."
        )
    keep_freed_memory()
    columns = [measure_step(config, s, rounds=flags.rounds) for s in flags.steps]
    rows = [
        (step, *(f"{number:.4g}" for number in column.values()))
        for step, column in zip(flags.steps, columns, strict=True)
    ]
    print(phrase_machine(describe_machine()), end=".\n\n")
    print(format_table(("step", *columns[0]), rows), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
