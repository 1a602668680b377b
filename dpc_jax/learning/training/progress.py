"""What a person sees of a long run: a bar on a terminal, plain lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn


class Display:
    """Bars on a terminal, where there is one; use as a context manager."""

    _bar: Progress | None = None

    def __enter__(self):
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_):
        if self._bar is not None:
            self._bar.stop()

    def tell(self, text: str):
        """Print a line of its own, above the bars where there are some."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
        else:
            print(text, flush=True)


class ProgressReport(Display):
    """Shows how far a run is; use as a context manager."""

    def __init__(self, title: str, *, total: int, start: int = 0):
        self._title, self._total = title, total
        if sys.stdout.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed}/{task.total}"),
                TextColumn("{task.fields[text]}"),
                console=Console(file=sys.stdout),
            )
            self._task = self._bar.add_task(
                title, total=total, completed=start, text=""
            )

    def advance(self, step: int):
        """Move the bar; plain output has no bar."""
        if self._bar is not None:
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
        rate = f"{steps_per_second:.1f} steps/s"
        left = "" if seconds_left is None else f"{seconds_left:.0f} s left"
        if self._bar is not None:
            text = f"loss {loss:.2f}  {rate}  {left}".rstrip()
            self._bar.update(self._task, completed=step, text=text)
            return
        parts = (f"step {step}/{self._total}", f"loss {loss:.2f}", rate, left)
        print(f"{self._title}: {', '.join(filter(None, parts))}", flush=True)

    @contextlib.contextmanager
    def compiling(self) -> Iterator[Callable[..., None]]:
        """Say "compiling" inside the context, and at its end how long it took.

        Yields:
          A function to call at the end, `finish(was_read=...)`: whether the program was
          read from the cache.
        """
        started, before = time.monotonic(), ""
        if self._bar is not None:
            before = self._bar.tasks[0].fields["text"]
            self._bar.update(self._task, text="compiling")
        else:
            print(f"{self._title}: compiling", flush=True)

        def finish(*, was_read: bool):
            how = "read from the cache of compiled programs" if was_read else "compiled"
            seconds = time.monotonic() - started
            self.tell(f"{self._title}: {how} in {seconds:.1f} s")

        yield finish
        if self._bar is not None:
            self._bar.update(self._task, text=before)


class CountReport(Display):
    """Shows how far several parts of a work are; use as a context manager.

    On a terminal each part has a bar; elsewhere a line for every tenth of it.
    """

    def __init__(self, title: str):
        self._title = title
        self._started = time.monotonic()
        self._told: dict[str, int] = {}
        self._tasks: dict[str, Any] = {}
        if sys.stdout.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed}/{task.total}"),
                console=Console(file=sys.stdout),
            )

    def report(self, part: str, done: int, total: int):
        """Show that so much of a part is done."""
        if self._bar is not None:
            if part not in self._tasks:
                self._tasks[part] = self._bar.add_task(part, total=total)
            self._bar.update(self._tasks[part], completed=done)
            return
        tenth = 10 * done // max(total, 1)
        if tenth > self._told.get(part, -1):
            self._told[part] = tenth
            seconds = time.monotonic() - self._started
            print(f"{self._title}: {part}, {done}/{total}, {seconds:.0f} s", flush=True)
