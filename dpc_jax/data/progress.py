"""Progress of long work: a bar on a terminal, lines elsewhere."""

import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any


def follow(
    results: Iterable[Any], *, count: int, label: str, progress: bool
) -> Iterator[Any]:
    """Pass on `count` results, one per model, and show how far they are."""
    if not progress:
        yield from results
        return
    if sys.stdout.isatty():
        from rich.progress import track  # not loaded where no bar is drawn

        yield from track(results, description=label, total=count)
        return
    start, shown = time.monotonic(), 0
    for done, result in enumerate(results, start=1):
        yield result
        if 10 * done // count > shown:
            shown = 10 * done // count
            rate = done / max(time.monotonic() - start, 1e-9)
            print(
                f"{label}: {done}/{count} models, {rate:.1f}/s, "
                f"{(count - done) / rate:.0f} s left",
                flush=True,
            )
