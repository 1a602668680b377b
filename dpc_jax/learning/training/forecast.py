"""How long a run still takes, at the pace of its last steps."""

import contextlib
import math
import time
from collections.abc import Iterator

MEMORY_SECONDS = 60.0  # after which what a step took counts 1/e: stages differ


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

    @contextlib.contextmanager
    def timing_validation(self) -> Iterator[None]:
        """Time a validation; the shortest counts: one may wait for compilation."""
        started = time.monotonic()
        yield
        seconds = time.monotonic() - started
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
