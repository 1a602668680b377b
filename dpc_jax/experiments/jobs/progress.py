"""What a person sees of the job list: bars on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from dpc_jax.learning.training.progress import Display


class JobProgress(Display):
    """Shows how far the runs are; use as a context manager.

    Args:
      total: runs in all.
      done: runs that were finished before.
    """

    def __init__(self, *, total: int, done: int):
        self._total, self._done, self._failed = total, done, 0
        self._running: dict[str, Any] = {}
        self._steps: Mapping[str, int] = {}
        if sys.stdout.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[text]}"),
                console=Console(file=sys.stdout),
            )
            self._all = self._bar.add_task("all runs", total=total, completed=done)
            self._bar.update(self._all, text="")
            self._tasks: dict[str, Any] = {}

    def begin(self, job: Any) -> None:
        """A job has begun."""
        name, step = job.run.name, job.count_steps()
        self._running[name] = job
        if self._bar is not None:
            total = job.config.train.steps
            self._tasks[name] = self._bar.add_task(
                name, total=total, completed=step, text=""
            )
            return
        self.tell(f"{name}: begins" + (f" at step {step}" if step else ""))

    def finish(self, job: Any, seconds: float) -> None:
        """A job has its report."""
        self._done += 1
        self._remove(job)
        self.tell(f"{job.run.name}: finished in {describe_time(seconds)}")

    def fail(self, job: Any, sentence: str) -> None:
        """A job has ended without a report."""
        self._failed += 1
        self._remove(job)
        self.tell(f"{job.run.name} failed: {sentence}")

    def update(self, steps: Mapping[str, int], left: float) -> None:
        """How far the running jobs are, by name, and the seconds left of all."""
        self._steps = dict(steps)
        if self._bar is None:
            return
        for name in self._running:
            total = self._running[name].config.train.steps
            text = f"step {steps[name]}/{total}"
            self._bar.update(self._tasks[name], completed=steps[name], text=text)
        text = f"{self._describe()}, {describe_time(left)} left"
        self._bar.update(self._all, completed=self._done + self._failed, text=text)

    def report(self, left: float) -> None:
        """A line on what is running; a terminal has its bars."""
        if self._bar is None:
            parts = [
                f"{name} {self._steps.get(name, 0)}/{job.config.train.steps}"
                for name, job in self._running.items()
            ]
            self.tell(
                f"{self._describe()}; {', '.join(parts)}; {describe_time(left)} left"
            )

    def _describe(self):
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{self._done} of {self._total} runs finished{failed}"

    def _remove(self, job):
        del self._running[job.run.name]
        if self._bar is not None:
            self._bar.remove_task(self._tasks.pop(job.run.name))


def describe_time(seconds: float) -> str:
    """Seconds for people: "40 s", "12 min", "3.5 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
