"""Rows that are measured on the data instead of trained, kept in DIR."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dpc_jax.config import Config
from dpc_jax.data.dataset import VERSION
from dpc_jax.experiments.analyses import load_function
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.results import Measured, Results
from dpc_jax.files import digest_text, write_json
from dpc_jax.run.setup import make_data_specs


def measure_rows(results: Results, folder: Path, *, is_last: bool) -> Measured:
    """Metrics of all rows that are measured, by row and category.

    Each needs the data of a finished run of its experiment and category. What was
    measured before on the same data is read.

    Args:
      results: with the finished runs.
      folder: of what is kept.
      is_last: False only reads.
    """
    found = {}
    for experiment, row, category, config in _list_rows(results):
        name = f"{experiment.name}-{row.measure.replace(':', '-')}-{category}"
        record, key = folder / name / "metrics.json", _make_key(config)
        metrics = _read(record, key)
        if metrics is None and is_last:
            record.parent.mkdir(parents=True, exist_ok=True)
            try:
                metrics = load_function(row.measure)(config)
            except (ValueError, OSError) as error:
                print(f"{row.label}, {category}, was not measured: {error}", flush=True)
                continue
            write_json(record, {"key": key, "metrics": metrics})
        if metrics is not None:
            found[experiment.name, row.label, category] = metrics
    return found


def _list_rows(results) -> Iterator[tuple[Experiment, Row, str, Config]]:
    for experiment in results.list_experiments():
        measured = [row for row in experiment.rows if row.measure]
        for category in results.list_categories(experiment) if measured else ():
            configs = (
                outcome.config
                for row in experiment.rows
                for outcome in results.list_outcomes(experiment, row, category)
                if outcome.config is not None
            )
            config = next(configs, None)
            if config is not None:
                yield from ((experiment, row, category, config) for row in measured)


def _make_key(config: Config) -> str:
    """Changes where the shapes of the data do."""
    specs = {name: repr(spec) for name, spec in make_data_specs(config).items()}
    return digest_text(json.dumps([VERSION, specs], sort_keys=True))


def _read(record: Path, key: str) -> Mapping[str, Any] | None:
    try:
        kept = json.loads(record.read_text(encoding="utf-8"))
        return kept["metrics"] if kept["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
