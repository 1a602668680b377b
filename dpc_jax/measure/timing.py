"""Clocks: several computations side by side, and the machine they ran on."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax

from dpc_jax.render.devices import count_cores


def measure_medians(
    calls: Mapping[str, Callable[[], Any]],
    *,
    rounds: int,
    budget_seconds: float = float("inf"),
) -> dict[str, float]:
    """Median seconds of each call; all calls take their turn in each round.

    So a machine that is slow for a while is slow for all of them. An additional first
    round, which compiles, is not counted. Each call must return the arrays that it
    computes; after its first, one that took `budget_seconds` in all gets no other.
    """
    for call in calls.values():
        jax.block_until_ready(call())
    seconds = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            if seconds[name] and sum(seconds[name]) >= budget_seconds:
                continue
            start = time.perf_counter()
            jax.block_until_ready(call())
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def describe_machine() -> dict[str, Any]:
    """What a reader must know to compare times with those of another machine."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.partition(":")[2] for line in lines if line.startswith("model name")]
    return {
        "processor": names[0].strip() if names else platform.machine(),
        "cores": count_cores(),
        "system": platform.system(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
        "devices": jax.local_device_count(),
        "load_at_start": os.getloadavg()[0],
    }


def phrase_machine(machine: Mapping[str, Any]) -> str:
    """A line of text about the machine, from `describe_machine`."""
    return (
        f"{machine['processor']}, {machine['cores']} of its cores, "
        f"{machine['system']}; JAX {machine['jax']} on {machine['backend']}, Python "
        f"{machine['python']}"
    )
