"""What a person sees of a long run: a bar on a terminal, lines elsewhere, time left."""

import contextlib
import math
import sys
import time
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

MEMORY_SECONDS = 60.0  # after which what a step took counts 1/e: stages differ


class ProgressReport:
    """Shows how far a run is, by a bar on a terminal; use as a context manager."""

    def __init__(self, title: str, *, total: int, start: int = 0):
        self._title, self._total = title, total
        self._is_plain = not sys.stdout.isatty()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TextColumn("{task.fields[text]}"),
            console=Console(file=sys.stdout),
            disable=self._is_plain,
        )
        self._task = self._bar.add_task(title, total=total, completed=start, text="")

    def __enter__(self):
        self._bar.start()
        return self

    def __exit__(self, *_):
        if not self._is_plain:  # where it would end with an empty line
            self._bar.stop()

    def tell(self, text: str):
        """Print a line of its own, above the bar where there is one."""
        if self._is_plain:
            print(text, flush=True)
        else:
            self._bar.console.print(text, highlight=False, markup=False)

    def advance(self, step: int):
        """Move the bar; plain output has no bar."""
        self._bar.update(self._task, completed=step)

    def report(
        self,
        step: int,
        *,
        loss: float,
        steps_per_second: float,
        seconds_left: float | None,
    ):
        """Show loss, rate and time left, which leaves out nothing that is still due."""
        parts = [f"loss {loss:.2f}", f"{steps_per_second:.1f} steps/s"]
        parts += [] if seconds_left is None else [f"{seconds_left:.0f} s left"]
        self._bar.update(self._task, completed=step, text="  ".join(parts))
        if self._is_plain:
            found = ", ".join([f"step {step}/{self._total}", *parts])
            self.tell(f"{self._title}: {found}")

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """Say "compiling" inside the context, and at its end how long it took."""
        started, before = time.monotonic(), self._bar.tasks[0].fields["text"]
        self._bar.update(self._task, text="compiling")
        if self._is_plain:
            self.tell(f"{self._title}: compiling")
        yield
        seconds = time.monotonic() - started
        self.tell(f"{self._title}: compiling took {seconds:.1f} s")
        self._bar.update(self._task, text=before)


class Forecast:
    """The seconds left of a run: its steps, its validations, and what comes after.

    Args:
      steps: of the run. start: steps done before this start.
      validate_every: steps; None without validation. The last step has one too.
      validations_after: how many validations what follows training takes as long as.
    """

    def __init__(
        self,
        steps: int,
        *,
        start: int = 0,
        validate_every: int | None = None,
        validations_after: float = 0.0,
    ):
        self._steps, self._done = steps, start
        self._every, self._after = validate_every, validations_after
        self._seconds = self._counted = self._validation = 0.0

    def add_rate(self, done: int, steps_per_second: float):
        """Take the rate of the steps since the last call, of which `done` is last."""
        count = done - self._done
        seconds = count / max(steps_per_second, 1e-9)
        kept = math.exp(-seconds / MEMORY_SECONDS)
        self._seconds = kept * self._seconds + seconds
        self._counted = kept * self._counted + count
        self._done = done

    def add_validation(self, seconds: float):
        """Take the time of one; the shortest counts: one may wait for compilation."""
        self._validation = min(self._validation or seconds, seconds)

    def compute_left(self, done: int) -> float | None:
        """Seconds until the end; None as long as no step has been timed."""
        if not self._counted:
            return None
        pace, validations = self._seconds / self._counted, self._after
        if self._every is not None and done < self._steps:
            every = self._every or self._steps
            validations += -(-self._steps // every) - done // every
        return pace * (self._steps - done) + validations * self._validation
