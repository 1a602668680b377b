"""What a person sees of a long run: a bar on a terminal, plain lines elsewhere."""

import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressReport:
    """Shows how far a run is; use as a context manager."""

    def __init__(self, title: str, *, total: int, start: int = 0):
        self._title, self._total = title, total
        self._bar = None
        if sys.stdout.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed}/{task.total}"),
                TextColumn("{task.fields[text]}"),
                TimeRemainingColumn(),
                console=Console(file=sys.stdout),
            )
            self._task = self._bar.add_task(
                title, total=total, completed=start, text=""
            )

    def __enter__(self):
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_):
        if self._bar is not None:
            self._bar.stop()

    def advance(self, step: int):
        """Move the bar; plain output has no bar."""
        if self._bar is not None:
            self._bar.update(self._task, completed=step)

    def report(self, step: int, *, loss: float, steps_per_second: float):
        """Show loss, rate and time left."""
        if self._bar is not None:
            text = f"loss {loss:.2f}  {steps_per_second:.1f} steps/s"
            self._bar.update(self._task, completed=step, text=text)
            return
        left = (self._total - step) / max(steps_per_second, 1e-9)
        print(
            f"{self._title}: step {step}/{self._total}, loss {loss:.2f}, "
            f"{steps_per_second:.1f} steps/s, {left:.0f} s left",
            flush=True,
        )

    def tell(self, text: str):
        """Print a line of its own, above the bar where there is one."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
        else:
            print(text, flush=True)
