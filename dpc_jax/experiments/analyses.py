"""What is made of finished runs beside tables: measures and pictures, kept in DIR."""

import dataclasses
import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.experiments.declarations import Experiment
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.files import digest_text, write_json


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What an experiment made of its finished runs.

    Attributes:
      metrics: numbers and words by name.
      figures: pictures.
      problem: why it was not made; "" where it was.
    """

    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    figures: Sequence[Path] = ()
    problem: str = ""


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
    used = done if experiment.reads == "all" else done[:1]
    key, record = _make_key(used), folder / "analysis.json"
    kept = _read(record, key)
    if kept:
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    workdirs = [outcome.workdir for outcome in used]
    try:
        run = load_function(experiment.analysis)
        metrics, figures = run(
            folder, workdirs if experiment.reads == "all" else workdirs[0]
        )
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
