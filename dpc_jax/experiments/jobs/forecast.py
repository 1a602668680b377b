"""How long the runs that are left will take."""

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dpc_jax.config import Config

# Seconds on one core, for the first guess alone: what runs really take corrects it.
_START = 25.0  # imports, compilation, report
_PER_PIXEL = 9e-6  # of a step: encoder, 16 views
_PER_VOXEL = 2.2e-7  # of a step: winners, 16 views, forward and backward
_PER_CHOICE = 1.5e-3  # of a step: a candidate of all views
_FIXED = 0.02  # of a step


def guess_seconds(config: Config, *, steps: int | None = None) -> float:
    """A first guess of how long a run takes on one core.

    Args:
      config: of the run.
      steps: that are left; None for all.
    """
    render, pose = config.render, config.pose
    fine = render.finest
    share = 1 - render.fine_from if render.fine_grid else 0.0
    voxels = (1 - share) * render.grid**3 + share * fine**3
    choices = pose.heads * pose.turns if pose.heads > 1 else 0
    step = (
        _FIXED
        + _PER_PIXEL * config.data.image_size**2
        + _PER_VOXEL * voxels
        + _PER_CHOICE * choices
    )
    return _START + step * (config.train.steps if steps is None else steps)


class Forecast:
    """Learns from the runs that it sees how long the others will take.

    Args:
      jobs: all that are to be trained.
    """

    def __init__(self, jobs: Iterable[Any]):
        self._jobs = {job.run.name: job for job in jobs}
        self._begun: dict[str, tuple[float, int]] = {}
        self._guessed = self._took = 0.0
        self.steps = {job.run.name: job.count_steps() for job in self._jobs.values()}

    @property
    def factor(self) -> float:
        """How many times its guess a run takes, by those that have ended."""
        return self._took / self._guessed if self._guessed else 1.0

    def observe(self, steps: Mapping[str, int]) -> None:
        """Note how far running jobs are, by name."""
        now = time.monotonic()
        for name, step in steps.items():
            self._begun.setdefault(name, (now, step))
            self.steps[name] = step

    def finish(self, job: Any, seconds: float, first_step: int) -> None:
        """Note a job that has ended after so many seconds, from a step on."""
        left = max(job.config.train.steps - first_step, 0)
        self._guessed += guess_seconds(job.config, steps=left)
        self._took += seconds
        self.steps[job.run.name] = job.config.train.steps

    def drop(self, job: Any) -> None:
        """Forget a job that has failed."""
        self._begun.pop(job.run.name, None)

    def estimate(
        self, running: Sequence[Any], waiting: Sequence[Any], *, slots: int
    ) -> float:
        """Seconds until the last job ends, each going to the slot that is free first.

        Args:
          running, waiting: jobs, the latter in the order in which they begin.
          slots: how many run side by side.
        """
        ends = sorted(self._estimate_running(job) for job in running)
        ends = [0.0] * (slots - len(ends)) + ends
        for job in waiting:
            steps = job.config.train.steps - self.steps[job.run.name]
            ends[0] += self.factor * guess_seconds(job.config, steps=max(steps, 0))
            ends.sort()
        return max(ends, default=0.0)

    def _estimate_running(self, job):
        """By the rate of its own steps, once there are some."""
        name, total = job.run.name, job.config.train.steps
        began, first = self._begun.get(name, (time.monotonic(), 0))
        step, passed = self.steps[name], time.monotonic() - began
        guess = self.factor * guess_seconds(job.config, steps=total - first)
        done = (step - first) / max(total - first, 1)
        by_rate = passed * (1 - done) / done if done > 0.05 else guess - passed
        return max(by_rate, 1.0)
