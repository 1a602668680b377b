"""The page of DIR: tables with the paper's numbers beside ours, and figures."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from dpc_jax.evaluation.metrics import MISSING, format_metric, get_metric
from dpc_jax.experiments.catalogue import NAMES, Experiment, Row
from dpc_jax.experiments.results import Analysis, Results, analyze
from dpc_jax.files import write_text
from dpc_jax.reporting.groups import ComparedRun, Group
from dpc_jax.reporting.tables import make_table
from dpc_jax.reporting.web.markup import assemble_page, embed_chart

TITLE = "The paper's experiments"
INTRODUCTION = (
    "Insafutdinov and Dosovitskiy, Unsupervised Learning of Shape and Pose with "
    "Differentiable Point Clouds (NeurIPS 2018). The paper's numbers are of ShapeNet "
    "after 600,000 steps; ours are of the runs listed, and each table says how these "
    "differ. So compare rows within a column, not the columns. Ours are mean ± "
    "standard deviation over the runs, which differ in the seed; one run has no "
    "spread. Minutes are wall clock, beside whatever else the machine did."
)
ONLY_RUNS = (
    "These runs have a few steps and tiny networks. They show that every experiment "
    "runs to its end; their figures say nothing about how well. --size=cpu and "
    "--size=full have figures that count."
)


def write_page(results: Results, folder: Path) -> Path:
    """Write index.html of all that was asked for; its figures lie in figures/."""
    request, outcomes = results.request, results.outcomes.values()
    done = [outcome for outcome in outcomes if outcome.metrics is not None]
    parts = [f"<h1>{TITLE}</h1>", _say(INTRODUCTION)]
    parts.append(_say(f"{len(done)} of {len(outcomes)} runs are finished."))
    for outcome in outcomes:
        if outcome.problem:
            parts.append(_say(f"{outcome.run.name} failed: {outcome.problem}"))
    if request.size == "quick":
        parts.append(_say(ONLY_RUNS))
    shown = request.list_experiments()
    for experiment in shown:
        figures = folder / "figures" / experiment.name
        parts += _show_experiment(results, experiment, figures)
    if left_out := [n for n in NAMES if n not in {e.name for e in shown}]:
        parts.append(_say(f"Not asked for here: {', '.join(left_out)}."))
    return write_text(folder / "index.html", assemble_page(TITLE, "".join(parts)))


def _say(text: str) -> str:
    return f"<p>{escape(text)}</p>\n"


def _show_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return make_table([map(escape, row) for row in rows], map(escape, heads), "numbers")


def _show_experiment(
    results: Results, experiment: Experiment, folder: Path
) -> list[str]:
    """The section of an experiment; its own figures are drawn in the folder."""
    parts = [f"<h2>{escape(experiment.title)}</h2>"]
    parts.append(_say(f"{experiment.question} Paper: {experiment.place}."))
    for category in results.request.list_categories(experiment):
        parts.append(_show_table(*tabulate(results, experiment, category)))
    parts += map(_say, (say_difference(results, experiment), *experiment.remarks))
    analysis = analyze(results, experiment, folder)
    parts += [_say(f"Not analysed: {problem}") for problem in analysis.problems]
    if analysis.measures:
        parts.append(_show_table(("Measure", "Value"), list_measures(analysis)))
    for path, caption in analysis.figures:
        chart = embed_chart(path, caption, is_photo=path.suffix != ".svg")
        parts.append(chart + _say(caption))
    return parts


def say_difference(results: Results, experiment: Experiment) -> str:
    """The sentence on how a table's runs differ from the paper's."""
    done = results.list_finished(experiment)
    if not done:
        return "None of its runs is finished yet."
    steps, trained, tested = (
        _join((o.metrics or {}).get(name) for o in done)
        for name in ("steps", "train_models", "test_models")
    )
    shapes = "ShapeNet" if results.request.shapenet else "procedural shapes"
    return (
        f"What differs: ours are trained on {shapes}, {trained} models a category, "
        f"tested on {tested} others, in {steps} steps; "
        "the paper's on ShapeNet's thousands of models a category, in 600,000 steps."
    )


def _join(values: Iterator) -> str:
    """Distinct numbers in order: "2,000 and 4,000"."""
    found = sorted({value for value in values if value is not None})
    return " and ".join(f"{value:,}" for value in found)


def tabulate(
    results: Results, experiment: Experiment, category: str
) -> tuple[list[str], list[list[str]]]:
    """The table of an experiment in a category: heads, and a line for each row."""
    heads, columns = [category], [[row.label for row in experiment.rows]]
    for metric in experiment.metrics:
        heading = get_metric(metric).heading
        published = [
            row.published.get(category, {}).get(metric) for row in experiment.rows
        ]
        ours = [
            results.make_group(row, category).describe(metric)
            for row in experiment.rows
        ]
        is_published = any(value is not None for value in published)
        if is_published:
            heads.append(f"{heading}, paper")
            columns.append([format_metric(metric, value) for value in published])
        if is_published or set(ours) != {MISSING}:  # others have no number
            heads.append(f"{heading}, ours")
            columns.append(ours)
    heads += ["Runs", "Minutes", "Memory (GB)"]
    costs = [_describe_cost(results, row, category) for row in experiment.rows]
    rows = zip(*columns, strict=True)
    return heads, [[*a, *b] for a, b in zip(rows, costs, strict=True)]


def _describe_cost(results: Results, row: Row, category: str) -> list[str]:
    """Runs, minutes of training and memory."""
    outcomes = results.list_outcomes(row, category)
    if not outcomes:
        return ["too long for this size", "", ""]
    group = results.make_group(row, category)
    if not group.runs:
        failed = any(outcome.problem for outcome in outcomes)
        return ["failed" if failed else "not run yet", "", ""]
    runs = str(len(group.runs))
    if len(group.runs) < len(outcomes):
        runs += f" of {len(outcomes)}"
    seconds, memory = map(group.summarize, ("train_seconds", "peak_memory_gb"))
    minutes = MISSING if seconds is None else f"{seconds.mean / 60:.1f}"
    return [runs, minutes, MISSING if memory is None else f"{memory.mean:.1f}"]


def list_measures(analysis: Analysis) -> list[tuple[str, str]]:
    """The measures of an analysis: their means over its runs, with the spread."""
    runs = [ComparedRun("", metrics=measures) for measures in analysis.measures]
    group, rows = Group("", tuple(runs)), []
    for name in analysis.measures[0]:
        if found := group.summarize(name):
            spread = f" ± {found.spread:.2g}" if found.spread else ""
            rows.append((name, f"{found.mean:.3g}{spread}"))
    return rows
