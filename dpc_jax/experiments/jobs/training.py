"""The job list: trains the runs that are missing, as many side by side as fit."""

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from dpc_jax.config import Config
from dpc_jax.experiments.jobs.forecast import Forecast
from dpc_jax.experiments.jobs.progress import JobProgress
from dpc_jax.experiments.results import read_metrics
from dpc_jax.experiments.runs import Run
from dpc_jax.run.workdir import list_differences, read_config

_POLL_SECONDS = 0.5
_REPORT_SECONDS = 60.0  # between lines on what is running
PROGRAM = ("-m", "dpc_jax.main")  # that trains a run, for Python
_GB_PER_RUN = 3.0  # the default run takes 2.8 while its programs compile


@dataclasses.dataclass(frozen=True)
class Job:
    """A run to be trained.

    Attributes:
      run: what is trained.
      config: that its flags stand for.
      workdir: its folder.
      log: file that its output is appended to.
      environment: variables of its process, beside those of this one.
    """

    run: Run
    config: Config
    workdir: Path
    log: Path
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def is_finished(self) -> bool:
        """Whether there is a report, of this config, whose metrics can be read."""
        page = self.workdir / "report" / "index.html"  # is written after the metrics
        if not page.is_file():
            return False
        try:
            read_metrics(self.workdir)
            return not list_differences(read_config(self.workdir), self.config)
        except ValueError:
            return False

    def count_steps(self) -> int:
        """The last step that is recorded."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            lines = (self.workdir / "metrics.jsonl").read_text(encoding="utf-8")
            return int(json.loads(lines.splitlines()[-1])["step"])
        return 0


@dataclasses.dataclass
class _Child:
    job: Job
    process: subprocess.Popen
    core: int
    started: float
    first_step: int
    log_start: int  # where this start's output begins in the log


def train_missing(
    jobs: Sequence[Job],
    *,
    cores: Sequence[int],
    progress: JobProgress,
    stop: threading.Event,
    on_end: Callable[[Job], object] = lambda job: None,
    program: Sequence[str] = PROGRAM,
) -> dict[str, str]:
    """Train jobs side by side until all are finished or have failed, or `stop` is set.

    Args:
      jobs: that are not finished, in the order in which they begin.
      cores: that a run each is kept to; -1 for a run that may use all.
      progress: told of every begin and end.
      stop: asks all runs to save and end.
      on_end: called after each job that ended, once another has begun in its place.
      program: arguments of Python before the flags of a run.

    Returns:
      Why jobs failed, by name of the run.
    """
    waiting, free, running, ended = list(jobs), list(cores), [], []
    forecast, failures = Forecast(jobs), {}
    reported = time.monotonic()
    try:
        while (waiting or running or ended) and not stop.is_set():
            while waiting and free:
                child = _start(waiting.pop(0), free.pop(0), program)
                running.append(child)
                progress.begin(child.job)
            while ended:
                on_end(ended.pop(0))
            stop.wait(_POLL_SECONDS)
            for child in [c for c in running if c.process.poll() is not None]:
                running.remove(child)
                free.append(child.core)
                if not stop.is_set():
                    _note_end(child, forecast, failures, progress)
                    ended.append(child.job)
            forecast.observe({c.job.run.name: c.job.count_steps() for c in running})
            left = forecast.estimate(
                [c.job for c in running], waiting, slots=len(cores)
            )
            progress.update(forecast.steps, left)
            if time.monotonic() - reported > _REPORT_SECONDS:
                reported = time.monotonic()
                progress.report(left)
    finally:
        _end(running, progress)
    return failures


def _start(job, core, program):
    """Start a run in a session of its own: Ctrl-C reaches it through this command."""
    job.log.parent.mkdir(parents=True, exist_ok=True)
    flags = [*job.run.list_flags(), f"--workdir={job.workdir}"]
    flags.append(f"--config.data.cache_dir={job.config.data.cache_dir}")
    if core >= 0:
        flags.append("--config.run.devices=1")
    words = [sys.executable, "-m", "dpc_jax.experiments.jobs.child", str(os.getpid())]
    with open(job.log, "ab") as log:
        log_start = log.tell()
        process = subprocess.Popen(
            [*words, str(core), *program, *flags],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **job.environment},
            start_new_session=True,
        )
    now = time.monotonic()
    return _Child(job, process, core, now, job.count_steps(), log_start)


def _note_end(child, forecast, failures, progress):
    job = child.job
    seconds = time.monotonic() - child.started
    if child.process.returncode == 0 and job.is_finished():
        forecast.finish(job, seconds, child.first_step)
        progress.finish(job, seconds)
        return
    failures[job.run.name] = sentence = read_failure(
        job.log, child.log_start, child.process.returncode
    )
    forecast.drop(job)
    progress.fail(job, sentence)


def read_failure(log: Path, start: int, status: int) -> str:
    """Why a run ended before its report: its own sentence, or its last line.

    Args:
      log: file with its output.
      start: byte that the output begins at.
      status: that it ended with; -9 for signal 9.
    """
    with open(log, "rb") as file:
        file.seek(start)
        text = file.read().decode("utf-8", "replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    own = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")]
    if own:
        return own[-1]
    if status < 0:
        return f"It was ended by {signal.Signals(-status).name}; see {log}."
    last = lines[-1] if lines else "it said nothing"
    return f"It ended with status {status} ({last.rstrip('.')}); see {log}."


def _end(running, progress):
    """Have the runs save and stop, and wait until they have.

    Ctrl-C while they do so kills them.
    """
    if running:
        progress.tell(f"Stopping {len(running)} runs, which save first.")
    try:
        for child in running:
            child.process.terminate()
        for child in running:
            child.process.wait()
    finally:
        for child in running:
            if child.process.poll() is None:
                child.process.kill()
                child.process.wait()


def choose_cores(limit: int = 0) -> list[int]:
    """The cores that a run each is kept to, as many as runs fit into memory.

    [-1] where runs come one after the other, with the whole machine each: on a GPU.

    Args:
      limit: how many runs at most; 0 for as many as fit.
    """
    if _find_platform() != "cpu":
        return [-1]
    if hasattr(os, "sched_getaffinity"):
        cores = sorted(os.sched_getaffinity(0))
    else:
        cores = list(range(os.cpu_count() or 1))
    fitting = max(1, int(_read_free_gb() // _GB_PER_RUN))
    return cores[: min(limit or len(cores), fitting)]


def _find_platform():
    """What JAX would run on, asked of another process: a GPU must not be taken here."""
    words = [sys.executable, "-c", "import jax; print(jax.default_backend())"]
    answer = subprocess.run(words, capture_output=True, text=True, check=False)
    return answer.stdout.strip() or "cpu"


def _read_free_gb():
    """Memory that is free; infinity where the system does not tell."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) / 2**20
    return float("inf")
