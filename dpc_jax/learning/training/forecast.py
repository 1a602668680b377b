"""How long a run still takes, from what its steps have taken so far."""

import contextlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence

from dpc_jax.learning.schedules import Span, Stage

MEMORY_SECONDS = 120.0  # after which what a step took counts 1/e: other load changes
_OTHER_STAGE = 0.5  # what the steps of the stage before count in a new one


class Forecast:
    """The seconds left of a run: steps by stage, validations, what comes after.

    Steps of later stages take longer. What they cost in relation to the current one is
    measured once their programs are there (`add_costs`); until then they are taken to
    cost the same.

    Args:
      spans: of the run's stages.
      start: steps done before this start.
      validate_every: steps; None without validation. The last step has one too.
      validations_after: how many validations what follows training takes as long as.
      waits: whether training waits for the program of each later stage.
    """

    def __init__(
        self,
        spans: Sequence[Span],
        *,
        start: int = 0,
        validate_every: int | None = None,
        validations_after: float = 0.0,
        waits: bool = False,
    ):
        self._spans, self._waits, self._done = tuple(spans), waits, start
        self._every, self._after = validate_every, validations_after
        self._costs: dict[Stage, float] = {}
        self._seconds = self._work = 0.0
        self._wait = self._validation = 0.0

    def add_rate(self, done: int, steps_per_second: float):
        """Take the rate of the steps since the last call, of which `done` is last."""
        seconds = (done - self._done) / max(steps_per_second, 1e-9)
        kept = math.exp(-seconds / MEMORY_SECONDS)
        if any(self._done <= span.start < done for span in self._spans):
            kept *= _OTHER_STAGE if self._costs else 0.0
        self._seconds = kept * self._seconds + seconds
        self._work = kept * self._work + self._sum_work(self._done, done)
        self._done = done

    def add_costs(self, costs: Mapping[Stage, float]):
        """Take what a step costs in each stage, in any unit that they share."""
        if not costs:
            return
        before = self._cost_at(max(0, self._done - 1))
        self._costs = dict(costs)
        self._work *= self._cost_at(max(0, self._done - 1)) / before
        # All programs are there: steps are no longer taken beside their compilation.
        self._seconds *= _OTHER_STAGE
        self._work *= _OTHER_STAGE

    def add_wait(self, seconds: float):
        """Take the seconds that training waited for programs since the last call."""
        self._wait = max(self._wait, seconds)

    @contextlib.contextmanager
    def timing_validation(self) -> Iterator[None]:
        """Time a validation; the shortest counts: one may wait for compilation."""
        started = time.monotonic()
        yield
        seconds = time.monotonic() - started
        self._validation = min(self._validation or seconds, seconds)

    def compute_left(self, done: int) -> float | None:
        """Seconds until the end; None as long as no step has been timed."""
        if not self._work:
            return None
        end = self._spans[-1].end
        rate = self._seconds / self._work
        waits = sum(span.start > done for span in self._spans) if self._waits else 0
        validations = self._after + self._count_validations(done, end)
        return (
            rate * self._sum_work(done, end)
            + validations * self._validation
            + waits * self._wait
        )

    def _count_validations(self, done, end):
        if self._every is None:
            return 0
        due = end // self._every - done // self._every if self._every else 0
        return due + (end > done and (not self._every or end % self._every > 0))

    def _sum_work(self, start, end):
        """The cost of the steps from `start` until just before `end`."""
        return sum(
            max(0, min(span.end, end) - max(span.start, start)) * cost
            for span, cost in zip(self._spans, self._list_costs(), strict=True)
        )

    def _cost_at(self, step):
        pairs = zip(self._spans, self._list_costs(), strict=True)
        return next(cost for span, cost in pairs if span.start <= step < span.end)

    def _list_costs(self):
        """The cost in each stage; an unknown one is taken to cost what a known does."""
        known = [self._costs.get(span.stage) for span in self._spans]
        last = next((cost for cost in known if cost), 1.0)
        return [last := cost or last for cost in known]
