"""The place of a process in its job, as flags or SLURM tell it."""

import os
import re
from collections.abc import Mapping
from typing import NamedTuple


class Place(NamedTuple):
    """The place of a process in its job.

    Attributes:
      coordinator: HOST:PORT at which process 0 is found.
      processes: how many the job has, at least 2.
      process: which of them this one is, from 0.
    """

    coordinator: str
    processes: int
    process: int


def find_place(
    coordinator: str | None, processes: int | None, process: int | None
) -> Place | None:
    """The place that flags or SLURM give a process; None for one on its own.

    Raises:
      ValueError: where the flags are not all given, or cannot be.
    """
    if coordinator is None and processes is None and process is None:
        return find_in_slurm(os.environ)
    if coordinator is None or processes is None or process is None:
        raise ValueError(
            "Expected --coordinator, --processes and --process together, but only some "
            "are given; give all three, or none for a process on its own."
        )
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ValueError(
            f"--coordinator must be HOST:PORT of process 0, but it is {coordinator!r}; "
            "write for example --coordinator=node01:7777."
        )
    if not 0 <= process < processes:
        raise ValueError(
            f"--process must be 0 or more and below --processes = {processes}, but it "
            f"is {process}; number the processes from 0."
        )
    return Place(coordinator, processes, process) if processes > 1 else None


def find_in_slurm(environment: Mapping[str, str]) -> Place | None:
    """The place of a task that srun has started beside others."""
    nodes = environment.get("SLURM_STEP_NODELIST")
    count = environment.get("SLURM_STEP_NUM_TASKS") or environment.get("SLURM_NTASKS")
    if not nodes or not count or int(count) < 2 or "SLURM_PROCID" not in environment:
        return None
    # Of node[07-09,12],other the first is node07.
    first = re.match(r"([^,\[]+)(?:\[([^,\-\]]+))?", nodes)
    host = "".join(part or "" for part in first.groups()) if first else nodes
    # Above the ports that Linux hands out by itself, and one for each step of a job.
    step = int(environment.get("SLURM_STEP_ID", 0))
    port = 61440 + (int(environment["SLURM_JOB_ID"]) + 31 * step) % 4096
    return Place(f"{host}:{port}", int(count), int(environment["SLURM_PROCID"]))
