"""What is made of finished runs beside tables: measures and pictures, kept in DIR."""

import dataclasses
import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.experiments.declarations import Experiment
from dpc_jax.experiments.results import Outcome, Results, summarize
from dpc_jax.files import digest_text, write_json


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What an experiment made of its finished runs.

    Attributes:
      metrics: numbers and words by name; of several runs means of the numbers.
      figures: pictures; of several runs those of the first.
      problem: why it was not made; "" where it was.
      runs: the metrics of each run; empty where all were read together.
    """

    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    figures: Sequence[Path] = ()
    problem: str = ""
    runs: Sequence[Mapping[str, Any]] = ()


def analyze(results: Results, folder: Path) -> dict[str, Analysis]:
    """The analyses of all experiments that have one, by name.

    One that was made of the same runs before is read instead.

    Args:
      results: with the finished runs.
      folder: of all analyses, a folder each.
    """
    return {
        experiment.name: _analyze_one(results, experiment, folder / experiment.name)
        for experiment in results.list_experiments()
        if experiment.analysis
    }


def _analyze_one(results: Results, experiment: Experiment, folder: Path) -> Analysis:
    done = [o for o in results.list_all(experiment) if o.metrics is not None]
    if not done:
        return Analysis(problem="its runs are missing.")
    if experiment.reads == "all":
        workdirs = [outcome.workdir for outcome in done]
        return _analyze_runs(experiment.analysis, folder, done, workdirs)
    made = [
        _analyze_runs(experiment.analysis, place, [outcome], outcome.workdir)
        for outcome, place in zip(done, _name_folders(folder, done), strict=True)
    ]
    return _average(made)


def _name_folders(folder, outcomes) -> list[Path]:
    """The first run's own files lie in the folder of the experiment."""
    return [folder, *(folder / outcome.run.name for outcome in outcomes[1:])]


def _average(made: Sequence[Analysis]) -> Analysis:
    """The first analysis with the means of all; those that failed are left out."""
    found = [analysis for analysis in made if not analysis.problem]
    if not found:
        return made[0]
    runs = [analysis.metrics for analysis in found]
    metrics = dict(runs[0])
    for name, value in metrics.items():
        if isinstance(value, float) and (mean := summarize(m.get(name) for m in runs)):
            metrics[name] = mean.mean
    return Analysis(metrics, found[0].figures, runs=runs)


def _analyze_runs(
    analysis: str, folder: Path, used: Sequence[Outcome], argument: Any
) -> Analysis:
    """Call an analysis with its workdir or workdirs, unless that was done before."""
    key, record = _make_key(used), folder / "analysis.json"
    kept = _read(record, key)
    if kept:
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    try:
        metrics, figures = load_function(analysis)(folder, argument)
    except (ValueError, OSError) as error:
        return Analysis(problem=str(error))
    names = [path.relative_to(folder).as_posix() for path in map(Path, figures)]
    write_json(record, {"key": key, "metrics": metrics, "figures": names})
    return _read(record, key) or Analysis(problem="it could not be read again.")


def load_function(name: str):
    """The function of "module:function"; its libraries are loaded only here.

    Raises:
      ValueError: where it is not there.
    """
    module, _, function = name.partition(":")
    try:
        found = importlib.import_module(f"dpc_jax.experiments.{module}")
        return getattr(found, function)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"Expected {function} in dpc_jax/experiments/{module}.py, but it cannot be "
            f"used ({error}); correct the experiment's analysis in "
            "dpc_jax/experiments/catalogue.py."
        ) from None


def _make_key(outcomes: Sequence[Outcome]) -> str:
    """Changes when other runs, or runs with other results, are analyzed."""
    parts = [
        f"{o.run.name} {json.dumps(o.metrics, sort_keys=True, default=str)}"
        for o in outcomes
    ]
    return digest_text("\n".join(parts))


def _read(record: Path, key: str) -> Analysis | None:
    """The analysis of that key; None where there is another one, or none whole."""
    try:
        kept = json.loads(record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    figures = [record.parent / name for name in kept.get("figures", ())]
    if kept.get("key") != key or not all(path.is_file() for path in figures):
        return None
    return Analysis(kept["metrics"], figures)
