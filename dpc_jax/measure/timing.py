"""Clocks: several computations side by side, and the machine they ran on."""

import os
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dpc_jax.render.devices import count_cores

# Those flags of a processor that decide the speed of a matrix product.
_FLAGS = ("avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16", "asimd", "sve")


def time_interleaved(
    calls: Mapping[str, Callable[[], Any]],
    *,
    rounds: int,
    budget_seconds: float = float("inf"),
) -> dict[str, list[float]]:
    """Seconds of each call, round by round, all calls in each round.

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
    return seconds


def measure_medians(
    calls: Mapping[str, Callable[[], Any]], *, rounds: int
) -> dict[str, float]:
    """Median seconds of each call, which take turns."""
    seconds = time_interleaved(calls, rounds=rounds)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def describe_machine() -> dict[str, Any]:
    """What a reader must know to compare times with those of another machine."""
    info = Path("/proc/cpuinfo")
    fields = {}
    for line in info.read_text().splitlines() if info.is_file() else []:
        name, _, value = line.partition(":")
        fields.setdefault(name.strip(), value.strip())
    flags = fields.get("flags", fields.get("Features", "")).split()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": fields.get("model name", platform.machine()),
        "cores": count_cores(),
        "flags": [flag for flag in _FLAGS if flag in flags],
        "system": platform.system(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "devices": jax.local_device_count(),
        "load_at_start": load,
    }


def phrase_machine(machine: Mapping[str, Any]) -> str:
    """A line of text about the machine, from `describe_machine`."""
    flags = ", ".join(machine["flags"]) or "no flags of note"
    return (
        f"{machine['processor']} ({flags}), {machine['cores']} of its cores, "
        f"{machine['system']}; JAX {machine['jax']} on {machine['backend']}, Python "
        f"{machine['python']}"
    )
