"""Trains the runs that are missing, a process of `dpc_jax.main` each, for the page."""

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

from dpc_jax.config import Config, replace_fields
from dpc_jax.experiments.page import write_page
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.experiments.runs import SIZES, Request, Run
from dpc_jax.learning.inference.predictor import VIEWS_AT_ONCE
from dpc_jax.run.process import catch_signals, prepare_process
from dpc_jax.run.workdir import (
    claim_workdir,
    hold_workdir,
    list_differences,
    read_config,
    read_metrics,
)

PROGRAM = ("-m", "dpc_jax.main")  # that trains a run, for Python
_BYTES_PER_RUN = 3 * 2**30  # the default run takes 2.8 GB while its programs compile
_POLL_SECONDS = 0.5


@dataclasses.dataclass(frozen=True)
class Job:
    """A run to be trained."""

    run: Run
    config: Config  # that its flags stand for
    workdir: Path  # its folder
    log: Path  # file of its output
    # Variables of its process, beside those of this one.
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def read_metrics(self) -> dict[str, Any] | None:
        """The test metrics of its report; None where there is no whole one."""
        page = self.workdir / "report" / "index.html"  # is written after the metrics
        with contextlib.suppress(ValueError):
            config = read_config(self.workdir)
            if page.is_file() and not list_differences(config, self.config):
                return read_metrics(self.workdir)
        return None


def run_suite(
    request: Request, folder: Path, *, trains: bool, cache: Path
) -> tuple[Path, int]:
    """Train what is missing of some runs, then write the page of the request.

    Args:
      folder: DIR, with a folder per run under runs/.
      trains: whether what is missing is trained, or left out of the page.
      cache: of rendered data sets.

    Returns:
      The page, and how many of the runs failed.

    Raises:
      ValueError: where another command uses DIR, or a config cannot work.
      KeyboardInterrupt: where Ctrl-C stopped it; the runs have saved.
    """
    prepare_process(VIEWS_AT_ONCE)  # the networks of finished runs are asked here
    with hold_workdir(folder), catch_signals() as stop:
        jobs = [_make_job(run, request, folder, cache) for run in request.list_runs()]
        problems = {}
        if trains:
            problems = train_missing(jobs, cores=choose_cores(), stop=stop)
        outcomes = {
            job.run.name: Outcome(
                job.run,
                job.workdir,
                job.read_metrics(),
                problems.get(job.run.name, ""),
            )
            for job in jobs
        }
        path = write_page(Results(request, outcomes), folder)
    return path, len(problems)


def _make_job(run: Run, request: Request, folder: Path, cache: Path) -> Job:
    config = replace_fields(run.load_config(), {"data": {"cache_dir": str(cache)}})
    log = folder / "logs" / f"{run.name}.txt"
    environment = SIZES[request.size].environment
    return Job(run, config, folder / "runs" / run.name, log, environment)


def train_missing(
    jobs: Sequence[Job], *, cores: Sequence[int], stop: threading.Event
) -> dict[str, str]:
    """Train jobs until all are finished or have failed, or `stop` is set.

    Args:
      jobs: those that are finished are left as they are.
      cores: that a run each is kept to; -1 for a run that may use all.
      stop: asks all runs to save and end.

    Returns:
      Why jobs failed, by name of the run.
    """
    waiting = collections.deque(job for job in jobs if job.read_metrics() is None)
    print(f"{len(jobs) - len(waiting)} of {len(jobs)} runs are finished.", flush=True)
    failures: dict[str, str] = {}

    def work(core):
        if core >= 0:
            os.sched_setaffinity(0, {core})  # this thread, and what it starts
        while not stop.is_set():
            try:
                job = waiting.popleft()
            except IndexError:
                return
            if problem := _train(job, core, stop):
                failures[job.run.name] = problem

    with ThreadPoolExecutor(len(cores)) as pool:
        list(pool.map(work, cores))
    return failures


def _train(job: Job, core: int, stop: threading.Event) -> str:
    """Train one run; why it failed, or ""."""
    name, started = job.run.name, time.monotonic()
    _say(f"{name}: begins")
    try:
        claim_workdir(job.workdir, job.config)
        problem = _run(job, core, stop)
    except (ValueError, OSError) as error:
        problem = str(error)
    minutes = (time.monotonic() - started) / 60
    end = f"failed: {problem}" if problem else f"ended after {minutes:.1f} min"
    _say(f"{name} {end}")
    return problem


def _say(text: str) -> None:
    """Print a line in one piece: several threads do."""
    print(f"{text}\n", end="", flush=True)


def _run(job: Job, core: int, stop: threading.Event) -> str:
    """Run the process to its end; why it failed, or "".

    It has a session of its own, so that Ctrl-C reaches it through this command alone.
    """
    flags = [*job.run.list_flags(), f"--workdir={job.workdir}"]
    flags.append(f"--config.data.cache_dir={job.config.data.cache_dir}")
    if core >= 0:
        flags.append("--config.run.devices=1")
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with open(job.log, "wb") as log:
        process = subprocess.Popen(
            [sys.executable, *PROGRAM, *flags],
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
    status = process.returncode
    if stop.is_set() or (status == 0 and job.read_metrics() is not None):
        return ""
    lines = job.log.read_text("utf-8", "replace").splitlines()
    own = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")]
    ended = f"ended by {signal.Signals(-status).name}" if status < 0 else ""
    ended = ended or f"over with status {status} and no report"
    return own[-1] if own else f"It was {ended}; see {job.log}."


def choose_cores() -> list[int]:
    """The cores that a run each is kept to, as many as runs fit into memory.

    [-1] where runs come one after the other, with the whole machine each: on a GPU.
    """
    # Another process is asked what JAX runs on: a GPU must not be taken here.
    words = [sys.executable, "-c", "import jax; print(jax.default_backend())"]
    answer = subprocess.run(words, capture_output=True, text=True, check=False)
    if (answer.stdout.strip() or "cpu") != "cpu":
        return [-1]
    cores = sorted(os.sched_getaffinity(0))
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return cores[: max(1, memory // _BYTES_PER_RUN)]
