"""What finished runs measured: by row of a table, mean and spread over seeds."""

import dataclasses
import json
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.config import Config
from dpc_jax.experiments.catalogue import NAMES
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.published import MEAN
from dpc_jax.experiments.runs import Request, Run
from dpc_jax.files import describe_error


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A run, and what came of it.

    Attributes:
      workdir: its folder.
      config: of the finished run; None where it is not finished.
      metrics: its `metrics.json`; None where it is not finished.
      problem: why it is not finished, as far as that is known.
    """

    run: Run
    workdir: Path
    config: Config | None = None
    metrics: Mapping[str, Any] | None = None
    problem: str = ""


Outcomes = Mapping[str, Outcome]  # by name of the run
# Metrics of rows that are not trained, by experiment, label of the row, and category.
Measured = Mapping[tuple[str, str, str], Mapping[str, Any]]


@dataclasses.dataclass(frozen=True)
class Summary:
    """A measure over the seeds of a row.

    Attributes:
      mean: of the values.
      spread: their standard deviation (n - 1); None of a single one.
      count: n.
    """

    mean: float
    spread: float | None
    count: int


def summarize(values: Iterable[Any]) -> Summary | None:
    """Mean and spread of the values that are numbers; None where there are none."""
    numbers = [float(v) for v in values if isinstance(v, int | float)]
    numbers = [number for number in numbers if math.isfinite(number)]
    if not numbers:
        return None
    spread = statistics.stdev(numbers) if len(numbers) > 1 else None
    return Summary(statistics.fmean(numbers), spread, len(numbers))


def read_metrics(workdir: Path) -> dict[str, Any]:
    """The test metrics of a finished run.

    Raises:
      ValueError: where they cannot be read.
    """
    path = workdir / "report" / "metrics.json"
    try:
        metrics = dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(
            f"Expected the metrics of a finished run in {path}, but they cannot be "
            f"read ({describe_error(error)}); remove the report, and give the same "
            "command again."
        ) from None
    return metrics


class Results:
    """The outcomes of all that was asked for, by experiment, row and category.

    Args:
      requests: that the page shows together; runs of all of them count.
      outcomes: by name of the run.
      measured: what rows that are not trained have.
    """

    def __init__(
        self,
        requests: Sequence[Request],
        outcomes: Outcomes,
        measured: Measured | None = None,
    ):
        self.requests, self._outcomes = tuple(requests), outcomes
        self._measured = measured or {}

    def list_experiments(self) -> list[Experiment]:
        """Experiments, each once, in the order of the catalogue."""
        found = {e.name: e for r in self.requests for e in r.list_experiments()}
        return sorted(found.values(), key=lambda e: NAMES.index(e.name))

    def list_categories(self, experiment: Experiment) -> list[str]:
        """Categories of an experiment, in the paper's order."""
        asked = {
            category
            for request in self.requests
            if experiment in request.list_experiments()
            for category in request.list_categories(experiment)
        }
        return [category for category in experiment.categories if category in asked]

    def list_outcomes(
        self, experiment: Experiment, row: Row, category: str
    ) -> list[Outcome]:
        """Outcomes of a row, by seed."""
        runs = {
            run.name: run
            for request in self.requests
            if experiment in request.list_experiments()
            and category in request.list_categories(experiment)
            for run in request.list_row_runs(row, category)
        }
        ordered = sorted(runs.values(), key=lambda run: run.seed)
        return [self._outcomes[run.name] for run in ordered]

    def explain_absence(self, row: Row) -> str:
        """Why no request has runs of a row; "" where one has."""
        reasons = [request.explain_absence(row) for request in self.requests]
        return reasons[0] if reasons and all(reasons) else ""

    def list_all(self, experiment: Experiment) -> list[Outcome]:
        """Outcomes of an experiment, each once."""
        found = {
            outcome.run.name: outcome
            for category in self.list_categories(experiment)
            for row in experiment.rows
            for outcome in self.list_outcomes(experiment, row, category)
        }
        return list(found.values())

    def summarize(
        self, experiment: Experiment, row: Row, category: str, metric: str
    ) -> Summary | None:
        """A measure of a row; of "mean", the mean over categories that all have it.

        The spread of that mean is the deviation that those of the categories, which are
        independent, come to.
        """
        if category != MEAN and row.measure:
            metrics = self._measured.get((experiment.name, row.label, category), {})
            return summarize([metrics.get(metric)])
        if category != MEAN:
            outcomes = self.list_outcomes(experiment, row, category)
            return summarize((o.metrics or {}).get(metric) for o in outcomes)
        parts = [
            self.summarize(experiment, row, name, metric)
            for name in self.list_categories(experiment)
        ]
        if not parts or None in parts:
            return None
        found = [part for part in parts if part is not None]
        spreads = [part.spread for part in found]
        spread = None
        if None not in spreads:
            spread = math.hypot(*(s or 0.0 for s in spreads)) / len(found)
        mean = statistics.fmean(part.mean for part in found)
        return Summary(mean, spread, min(part.count for part in found))

    def find_published(
        self, experiment: Experiment, row: Row, category: str, metric: str
    ) -> float | None:
        """The paper's number of a row; the mean is of the same categories as ours."""
        if category != MEAN:
            return experiment.table.find(row.published, category, metric)
        categories = self.list_categories(experiment)
        return experiment.table.find_mean(row.published, categories, metric)

    def collect(
        self, experiment: Experiment, read: Callable[[Config], Any]
    ) -> list[Any]:
        """What the configs of the finished runs say, each value once, in order."""
        configs = [o.config for o in self.list_all(experiment) if o.config]
        return sorted({read(config) for config in configs})
