"""What finished runs gave: groups of seeds, measured rows, analyses."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.experiments import correspondences, interpolation, point_sizes
from dpc_jax.experiments.catalogue import Experiment, Row
from dpc_jax.experiments.runs import Request, Run
from dpc_jax.reporting.groups import ComparedRun, Group


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A run, and what came of it."""

    run: Run
    workdir: Path  # its folder
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
        """The finished runs of a row."""
        runs = [
            ComparedRun(outcome.run.name, metrics=outcome.metrics)
            for outcome in self.list_outcomes(row, category)
            if outcome.metrics is not None
        ]
        return Group(row.label, tuple(runs))


@dataclasses.dataclass
class Analysis:
    """What an experiment made of its finished runs."""

    # Of each run, by name for people
    measures: list[Mapping[str, float]] = dataclasses.field(default_factory=list)
    figures: Sequence[tuple[Path, str]] = ()  # with captions
    problems: list[str] = dataclasses.field(default_factory=list)  # what was not made


# Of each run, by the name of the experiment: measures and figures.
_OF_A_RUN: dict[str, Callable] = {
    "correspondences": correspondences.run,
    "interpolation": interpolation.run,
}


def analyze(results: Results, experiment: Experiment, folder: Path) -> Analysis:
    """The analysis of an experiment, its figures in a folder; an empty one of others.

    What fails leaves the rest as it is. Of analyses of single runs the figures of the
    first run are kept.
    """
    found = Analysis()
    workdirs = [outcome.workdir for outcome in results.list_finished(experiment)]
    parts: list[Callable[[], tuple]] = []
    if experiment.name == "points" and workdirs:
        parts = [functools.partial(point_sizes.run, folder, workdirs)]
    elif measure := _OF_A_RUN.get(experiment.name):
        # Figures of the same name replace each other: those of the first run come last.
        parts = [functools.partial(measure, folder, one) for one in reversed(workdirs)]
    for part in parts:
        try:
            measures, found.figures = part()
            found.measures += [measures] if measures else []
        except (ValueError, OSError) as error:
            found.problems.append(str(error))
    return found
