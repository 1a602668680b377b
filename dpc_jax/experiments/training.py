"""Trains the runs that are missing: a process of `dpc_jax.main` each, some at once."""

import collections
import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from dpc_jax.config import Config
from dpc_jax.experiments.runs import Run
from dpc_jax.run.workdir import (
    claim_workdir,
    list_differences,
    read_config,
    read_metrics,
)

PROGRAM = ("-m", "dpc_jax.main")  # that trains a run, for Python
_GB_PER_RUN = 3.0  # the default run takes 2.8 while its programs compile
_POLL_SECONDS = 0.5


@dataclasses.dataclass(frozen=True)
class Job:
    """A run to be trained."""

    run: Run
    config: Config  # that its flags stand for
    workdir: Path  # its folder
    log: Path  # file that its output is appended to
    # Variables of its process, beside those of this one.
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def read_metrics(self) -> dict[str, Any] | None:
        """The test metrics of its report; None where it is not finished.

        Raises:
          ValueError: where they cannot be read.
        """
        page = self.workdir / "report" / "index.html"  # is written after the metrics
        if not page.is_file():
            return None
        if list_differences(read_config(self.workdir), self.config):
            return None
        return read_metrics(self.workdir)

    def is_finished(self) -> bool:
        """Whether there is a whole report of this config."""
        with contextlib.suppress(ValueError):
            return self.read_metrics() is not None
        return False


def train_missing(
    jobs: Sequence[Job],
    *,
    cores: Sequence[int],
    stop: threading.Event,
    program: Sequence[str] = PROGRAM,
) -> dict[str, str]:
    """Train jobs until all are finished or have failed, or `stop` is set.

    Args:
      jobs: those that are finished are left as they are.
      cores: that a run each is kept to; -1 for a run that may use all.
      stop: asks all runs to save and end.
      program: arguments of Python before the flags of a run.

    Returns:
      Why jobs failed, by name of the run.
    """
    waiting = collections.deque(job for job in jobs if not job.is_finished())
    print(f"{len(jobs) - len(waiting)} of {len(jobs)} runs are finished.", flush=True)
    failures: dict[str, str] = {}

    def work(core):
        if core >= 0 and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {core})  # this thread, and what it starts
        while waiting and not stop.is_set():
            with contextlib.suppress(IndexError):  # another thread was quicker
                job = waiting.popleft()
                if problem := _train(job, core, stop, program):
                    failures[job.run.name] = problem

    with ThreadPoolExecutor(len(cores)) as pool:
        list(pool.map(work, cores))
    return failures


def _train(job: Job, core: int, stop: threading.Event, program: Sequence[str]) -> str:
    """Train one run; why it failed, or "" where it did not."""
    name, started = job.run.name, time.monotonic()
    _say(f"{name}: begins")
    try:
        claim_workdir(job.workdir, job.config)
        start, status = _run(job, core, stop, program)
    except (ValueError, OSError) as error:
        problem = str(error)
    else:
        if stop.is_set() or (status == 0 and job.is_finished()):
            problem = ""
        else:
            problem = _read_failure(job.log, start, status)
    minutes = (time.monotonic() - started) / 60
    end = f"failed: {problem}" if problem else f"ended after {minutes:.1f} min"
    _say(f"{name} {end}")
    return problem


def _say(text: str) -> None:
    """Print a line in one piece: several threads do."""
    print(f"{text}\n", end="", flush=True)


def _run(job, core, stop, program) -> tuple[int, int]:
    """Run the process to its end; where its output begins in the log, its status.

    It has a session of its own, so that Ctrl-C reaches it through this command alone.
    """
    flags = [*job.run.list_flags(), f"--workdir={job.workdir}"]
    flags.append(f"--config.data.cache_dir={job.config.data.cache_dir}")
    if core >= 0:
        flags.append("--config.run.devices=1")
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with open(job.log, "ab") as log:
        start = log.tell()
        process = subprocess.Popen(
            [sys.executable, *program, *flags],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **job.environment},
            start_new_session=True,
        )
        while process.poll() is None:
            if stop.wait(_POLL_SECONDS):
                process.terminate()  # it saves
                process.wait()
    return start, process.returncode


def _read_failure(log: Path, start: int, status: int) -> str:
    """Why a run ended before its report, by its own sentence after a byte of its log.

    Args:
      status: that it ended with; -9 for signal 9.
    """
    with open(log, "rb") as file:
        file.seek(start)
        lines = file.read().decode("utf-8", "replace").splitlines()
    own = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")]
    if own:
        return own[-1]
    if status < 0:
        return f"It was ended by {signal.Signals(-status).name}; see {log}."
    return f"It ended with status {status} and no report; see {log}."


def choose_cores(limit: int = 0) -> list[int]:
    """The cores that a run each is kept to, as many as runs fit into memory.

    [-1] where runs come one after the other, with the whole machine each: on a GPU.

    Args:
      limit: how many runs at most; 0 for as many as fit.
    """
    # Another process is asked what JAX runs on: a GPU must not be taken here.
    words = [sys.executable, "-c", "import jax; print(jax.default_backend())"]
    answer = subprocess.run(words, capture_output=True, text=True, check=False)
    if (answer.stdout.strip() or "cpu") != "cpu":
        return [-1]
    if hasattr(os, "sched_getaffinity"):
        cores = sorted(os.sched_getaffinity(0))
    else:
        cores = list(range(os.cpu_count() or 1))
    fitting = max(1, int(_read_free_gb() // _GB_PER_RUN))
    return cores[: min(limit or len(cores), fitting)]


def _read_free_gb() -> float:
    """Memory that is free; infinity where the system does not tell."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) / 2**20
    return float("inf")
