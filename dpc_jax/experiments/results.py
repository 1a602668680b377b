"""What finished runs gave: groups of seeds, measured rows, analyses kept in DIR."""

import dataclasses
import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.config import Config
from dpc_jax.experiments import correspondences, interpolation, point_sizes
from dpc_jax.experiments.catalogue import Experiment, Row
from dpc_jax.experiments.published import MEAN
from dpc_jax.experiments.runs import Request, Run
from dpc_jax.files import digest_text, write_json
from dpc_jax.reporting.groups import ComparedRun, Group

_MEAN = "mean_shape_chamfer"  # of each run's own report


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A run, and what came of it."""

    run: Run
    workdir: Path  # its folder
    config: Config | None = None  # None where it cannot work
    metrics: Mapping[str, Any] | None = None  # None where it is not finished
    problem: str = ""  # why it is not finished, as far as that is known


@dataclasses.dataclass(frozen=True)
class Results:
    """The outcomes of a request, by experiment, row and category."""

    request: Request
    outcomes: Mapping[str, Outcome]  # by name of the run

    def list_outcomes(self, row: Row, category: str) -> list[Outcome]:
        """Outcomes of a row, by seed."""
        runs = self.request.list_row_runs(row, category)
        return [self.outcomes[run.name] for run in runs]

    def list_finished(self, experiment: Experiment) -> list[Outcome]:
        """Finished runs of an experiment, each once."""
        found = {
            outcome.run.name: outcome
            for name in self.request.list_categories(experiment)
            for row in experiment.rows
            for outcome in self.list_outcomes(row, name)
            if outcome.metrics is not None
        }
        return list(found.values())

    def make_group(self, row: Row, category: str) -> Group:
        """The finished runs of a row; of the mean shape what one of them measured."""
        if row.variant is None:
            outcomes = [o for o in self.outcomes.values() if o.run.category == category]
            known = ((o.metrics or {}).get(_MEAN) for o in outcomes)
            value = next((v for v in known if v is not None), None)
            found = {row.label: None if value is None else {"chamfer": value}}
        else:
            outcomes = self.list_outcomes(row, category)
            found = {o.run.name: o.metrics for o in outcomes}
        runs = [ComparedRun(n, metrics=m) for n, m in found.items() if m is not None]
        return Group(row.label, tuple(runs))

    def find_mean(self, experiment: Experiment, row: Row, metric: str) -> float | None:
        """The mean of a measure over the categories if all have it."""
        categories = self.request.list_categories(experiment)
        found = [self.make_group(row, name).summarize(metric) for name in categories]
        means = [summary.mean for summary in found if summary is not None]
        return statistics.fmean(means) if means and None not in found else None

    def find_published(
        self, experiment: Experiment, row: Row, category: str, metric: str
    ) -> float | None:
        """The paper's number of a row; the mean is of the same categories as ours."""
        if category != MEAN:
            return experiment.table.find(row.published, category, metric)
        categories = self.request.list_categories(experiment)
        return experiment.table.find_mean(row.published, categories, metric)


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What an experiment made of its finished runs."""

    measures: Sequence[Mapping[str, float]] = ()  # of each run, by name for people
    figures: Sequence[tuple[Path, str]] = ()  # of the first run, with captions
    problem: str = ""  # why it was not made; "" where it was


_TOGETHER = {"points": point_sizes.draw_errors, "covariance": point_sizes.draw_shapes}
_EACH = {"correspondences": correspondences.run, "interpolation": interpolation.run}


def analyze(results: Results, experiment: Experiment, folder: Path) -> Analysis:
    """The analysis of an experiment; an empty one where it has none.

    Args:
      folder: of its figures. What was made of the same runs is read.
    """
    name, done = experiment.name, results.list_finished(experiment)
    if not done or name not in (_TOGETHER | _EACH):
        return Analysis()
    try:
        if name in _TOGETHER:
            figures = _TOGETHER[name](folder, [outcome.workdir for outcome in done])
            return Analysis(figures=figures)
        made = [
            _analyze_one(_EACH[name], folder / o.run.name if i else folder, o)
            for i, o in enumerate(done)
        ]
    except (ValueError, OSError) as error:
        return Analysis(problem=str(error))
    figures = [(folder / file, caption) for file, caption in made[0]["figures"]]
    return Analysis([one["measures"] for one in made], figures)


def _analyze_one(run: Callable, folder: Path, outcome: Outcome) -> dict[str, Any]:
    def make():
        folder.mkdir(parents=True, exist_ok=True)
        measures, figures = run(folder, outcome.workdir)
        named = [(path.name, caption) for path, caption in figures]
        return {"measures": measures, "figures": named}

    return _keep(folder / "analysis.json", outcome.metrics, make)


def _keep(record: Path, of: Any, make: Callable[[], dict]) -> dict[str, Any]:
    """What `make` gives, read from a file where it was made of the same before."""
    key = digest_text(json.dumps(of, sort_keys=True, default=str))
    try:
        kept = json.loads(record.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return kept["made"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    made = make()
    write_json(record, {"key": key, "made": made})
    return made
