"""A training step against the number of devices: seconds, and bytes that they exchange.

    python -m dpc_jax.measure.device_scaling --out=DIR

All numbers of devices are timed in one process, in turn, so that other load meets all
of them alike. CPU cores are devices; where there are GPUs, those are taken.
"""

import argparse
import dataclasses
import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from dpc_jax.config import Config, build_config, replace_fields
from dpc_jax.files import write_json
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.step import init_state, make_train_step
from dpc_jax.measure.step_parts import draw_batch
from dpc_jax.measure.step_profile import CAR, can_measure
from dpc_jax.measure.timing import (
    describe_machine,
    phrase_machine,
    take_medians,
    time_interleaved,
)
from dpc_jax.reporting import style
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.process import keep_freed_memory, split_cores
from dpc_jax.run.setup import make_network

_EXCHANGE = re.compile(
    r"^.*?= (.*?) (all-gather|all-reduce|all-to-all|reduce-scatter)\(", re.M
)
_ARRAY = re.compile(r"(f32|s32|u32|pred)\[([\d,]*)\]")


class Exchange(NamedTuple):
    """What a device receives from the others in a step.

    Attributes:
      count: of exchanges. sums: bytes of sums over devices, other: of rows and columns.
    """

    count: int
    sums: int
    other: int


def count_exchanges(program: str) -> Exchange:
    """Read the exchanges from the text of a compiled program.

    The bytes are those of their results. Exchanges inside of loops count once.
    """
    count, sums, other = 0, 0, 0
    for result, kind in _EXCHANGE.findall(program):
        size = sum(
            math.prod(int(side) for side in sides.split(",") if side)
            * (1 if name == "pred" else 4)
            for name, sides in _ARRAY.findall(result)
        )
        count += 1
        if kind == "all-reduce":
            sums += size
        else:
            other += size
    return Exchange(count, sums, other)


def make_call(config: Config, count: int, step: int) -> tuple[Any, Exchange]:
    """The step with this number on some devices, as a call, and what it exchanges."""
    config = replace_fields(config, {"run": {"devices": count}})
    network, batch = make_network(config), draw_batch(config)
    mesh = devices.make_mesh(config)
    stage = schedules.find_stage(step, config.render, steps=config.train.steps)
    state = init_state(network, config)
    first = jax.device_put(state.step + step, state.step.sharding)
    held = [state._replace(step=first)]
    program = make_train_step(network, config, stage).lower(held[0], batch).compile()

    def call():
        held[0], metrics = program(held[0], batch)
        return metrics

    assert mesh.size == count
    return call, count_exchanges(program.as_text())


def draw_scaling(seconds: Mapping[int, Mapping[str, float]], path: Path) -> Path:
    """Milliseconds of steps against devices, each with the line of an ideal speed-up.

    Args:
      seconds: by number of the step, then by number of devices.
      path: of the picture.
    """
    figure = style.make_figure(5.0, 3.4)
    (axes,) = style.make_panels(figure, 1, columns=1)
    style.label_axes(axes, x_label="devices", y_label="ms of a step", grid="both")
    for color, (step, times) in zip(style.SERIES, seconds.items(), strict=False):
        counts = [int(count) for count in times]
        found = [1e3 * value for value in times.values()]
        ideal = [found[0] * counts[0] / count for count in counts]
        axes.plot(counts, found, "o-", color=color, label=f"step {step}")
        axes.plot(counts, ideal, ":", color=color)
    axes.set_xticks(counts)
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8, frameon=False, title="dotted: ideal", title_fontsize=8)
    return style.save_figure(figure, path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("device_scaling"))
    parser.add_argument("--variant", default="", help="of the config, such as paper")
    parser.add_argument("--steps", type=int, nargs="+", default=[0, 3000, 3900, 5500])
    parser.add_argument("--rounds", type=int, default=21)
    flags = parser.parse_args(arguments)
    config = build_config("car", flags.variant, CAR)
    if not can_measure(config, flags.steps, rounds=flags.rounds):
        return 1
    objects = config.train.models_per_batch
    split_cores(objects)
    keep_freed_memory()
    counts = [n for n in range(1, jax.local_device_count() + 1) if objects % n == 0]
    measured, exchanges = {}, {}
    for step in flags.steps:
        calls = {}
        for count in counts:
            calls[str(count)], exchanges[count] = make_call(config, count, step)
        measured[step] = take_medians(time_interleaved(calls, rounds=flags.rounds))
    heads = ("devices", *(f"step {step}, ms" for step in flags.steps), "times as fast")
    heads = (*heads, "exchanges", "sums, MB", "rows, MB")
    rows = []
    for count in counts:
        times = [measured[step][str(count)] for step in flags.steps]
        gains = [measured[s]["1"] / t for s, t in zip(flags.steps, times, strict=True)]
        exchange = exchanges[count]
        rows.append(
            (
                str(count),
                *(f"{1e3 * t:.1f}" for t in times),
                f"{min(gains):.2f} to {max(gains):.2f}",
                str(exchange.count),
                f"{exchange.sums / 1e6:.2f}",
                f"{exchange.other / 1e6:.2f}",
            )
        )
    print(phrase_machine(describe_machine()), end=".\n\n")
    print(format_table(heads, rows, align="r" * len(heads)), end="")
    flags.out.mkdir(parents=True, exist_ok=True)
    facts = {
        "machine": describe_machine(),
        "seconds": measured,
        "exchanges": {n: exchange._asdict() for n, exchange in exchanges.items()},
        "config": dataclasses.asdict(config),
    }
    write_json(flags.out / "device_scaling.json", facts)
    print(f"Picture: {draw_scaling(measured, flags.out / 'device_scaling.png')}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
