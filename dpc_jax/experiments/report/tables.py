"""Tables of the page: the paper's number beside ours, with what ours cost."""

import dataclasses
from collections.abc import Sequence

from dpc_jax.evaluation.metrics import MISSING, get_metric
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.published import MEAN
from dpc_jax.experiments.results import Results, Summary

NOT_TRAINED = "measured on the data"
NOT_YET = "not run yet"


@dataclasses.dataclass(frozen=True)
class Table:
    """Cells as text, row by row under their heads."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


def make_table(results: Results, experiment: Experiment) -> Table:
    """The table of an experiment: a line per category and row, then their means."""
    categories = results.list_categories(experiment)
    shown = [m for m in experiment.metrics if _is_shown(results, experiment, m)]
    published = [m for m in shown if _is_published(experiment, m)]
    heads = ["Category", "Method"]
    for metric in shown:
        heading = get_metric(metric).heading
        heads += [f"{heading}, paper"] * (metric in published) + [f"{heading}, ours"]
    heads += ["Runs", "Minutes", "Memory (GB)"]
    names = [*categories, MEAN] if len(categories) > 1 else categories
    rows = [
        _make_row(results, experiment, row, category, shown, published)
        for category in names
        for row in experiment.rows
    ]
    return Table(heads, rows)


def _make_row(results, experiment, row, category, shown, published):
    cells = [category, row.label]
    for metric in shown:
        if metric in published:
            value = results.find_published(experiment, row, category, metric)
            cells.append(format_value(metric, value))
        summary = results.summarize(experiment, row, category, metric)
        cells.append(format_summary(metric, summary))
    return cells + _describe_cost(results, experiment, row, category)


def _describe_cost(results: Results, experiment: Experiment, row: Row, category):
    """Runs, minutes of training and memory; the mean has those of its categories."""
    if row.variant is None:
        return [NOT_TRAINED, "", ""]
    if category == MEAN:
        return ["", "", ""]
    outcomes = results.list_outcomes(experiment, row, category)
    if not outcomes:
        return [results.explain_absence(row), "", ""]
    done = [o for o in outcomes if o.metrics is not None]
    if not done:
        failed = any(o.problem for o in outcomes)
        return ["failed" if failed else NOT_YET, "", ""]
    runs = str(len(done))
    if len(done) < len(outcomes):
        runs += f" of {len(outcomes)}"
    seconds = results.summarize(experiment, row, category, "train_seconds")
    memory = results.summarize(experiment, row, category, "peak_memory_gb")
    minutes = MISSING if seconds is None else f"{seconds.mean / 60:.1f}"
    return [runs, minutes, MISSING if memory is None else f"{memory.mean:.1f}"]


def format_value(metric: str, value: float | None) -> str:
    """A number in the unit and rounding of its metric; an en dash for None."""
    if value is None:
        return MISSING
    known = get_metric(metric)
    return format(known.factor * value, known.format)


def format_summary(metric: str, summary: Summary | None) -> str:
    """Mean ± standard deviation; of a single run its value with "(one run)"."""
    if summary is None:
        return MISSING
    mean = format_value(metric, summary.mean)
    if summary.spread is None:
        return f"{mean} (n = 1)"
    return f"{mean} ± {format_value(metric, summary.spread)} (n = {summary.count})"


def _is_shown(results, experiment, metric):
    """Whether anybody has a number: columns without one are left out."""
    if _is_published(experiment, metric):
        return True
    return any(
        results.summarize(experiment, row, category, metric)
        for category in results.list_categories(experiment)
        for row in experiment.rows
    )


def _is_published(experiment, metric):
    return any(
        metric in values
        for by_category in experiment.table.rows.values()
        for values in by_category.values()
    )
