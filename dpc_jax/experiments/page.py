"""The page of DIR: tables with the paper's numbers beside ours, and figures.

It is written as HTML and as Markdown alike.
"""

import base64
import html
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from dpc_jax.evaluation.metrics import MISSING, format_metric, get_metric
from dpc_jax.experiments.catalogue import NAMES, Experiment, Row
from dpc_jax.experiments.published import MEAN, TITLE
from dpc_jax.experiments.results import Analysis, Results, analyze
from dpc_jax.experiments.runs import SIZES, SOURCES
from dpc_jax.files import write_text
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.reporting.comparison import draw_comparison
from dpc_jax.reporting.groups import ComparedRun, Group
from dpc_jax.reporting.tables import format_table, make_table
from dpc_jax.reporting.web.markup import assemble_page, embed_chart

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
OTHER_SYSTEMS = (
    "The other systems have the data, the image encoder, the batches and the "
    "evaluation of the point clouds. What of each is followed and what differs is in "
    "the documentation (baselines.md)."
)
_WIDTH = 900  # pixels, of a picture of a run
Figures = list[tuple[Path, str]]  # with their captions


class Page:
    """A page that grows, as HTML and as Markdown.

    Args:
      folder: that it is written into; figures lie below it.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.markdown: list[str] = []
        self.html: list[str] = []
        self.figures: list[Path] = []

    def add_heading(self, text: str, level: int = 2) -> None:
        """A heading; level 1 is the page's."""
        self.markdown.append(f"{'#' * level} {text}")
        self.html.append(f"<h{level}>{html.escape(text)}</h{level}>")

    def add_text(self, text: str) -> None:
        """A paragraph."""
        self.markdown.append(text)
        self.html.append(f"<p>{html.escape(text)}</p>")

    def add_table(self, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table of cells as text."""
        self.markdown.append(format_table(heads, rows).rstrip("\n"))
        shown = [[html.escape(cell) for cell in row] for row in rows]
        titles = [html.escape(head) for head in heads]
        self.html.append(make_table(shown, titles, kind="numbers"))

    def add_figure(self, path: Path, caption: str) -> None:
        """A picture of the page's folder."""
        self.figures.append(path)
        link = path.relative_to(self.folder).as_posix()
        self.markdown.append(f"![{caption}]({link})\n\n{caption}")
        text = html.escape(caption)
        if path.suffix == ".gif":
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            shown = f'<img alt="{text}" src="data:image/gif;base64,{data}">'
        else:
            shown = embed_chart(path, caption, is_photo=path.suffix != ".png")
        self.html.append(f"{shown}<p>{text}</p>")

    def write(self) -> Path:
        """Write index.html, its figures inside, and paper.md; the path of the first."""
        write_text(self.folder / "paper.md", "\n\n".join(self.markdown) + "\n")
        page = assemble_page(TITLE, "".join(self.html))
        return write_text(self.folder / "index.html", page)

    def publish(self, path: Path) -> Path:
        """Write the Markdown elsewhere, its figures into images/NAME/ beside it."""
        text = "\n\n".join(self.markdown) + "\n"
        images = f"images/{path.stem}"
        for figure in self.figures:
            link = figure.relative_to(self.folder)
            copy = path.parent / images / "-".join(link.parts[1:])
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(figure, copy)
            text = text.replace(f"]({link.as_posix()})", f"]({images}/{copy.name})")
        return write_text(path, text)


def make_page(results: Results, folder: Path) -> Page:
    """The page of all that was asked for; figures are drawn below its folder."""
    page, request = Page(folder), results.request
    page.add_heading(TITLE, 1)
    page.add_text(INTRODUCTION)
    outcomes = results.outcomes.values()
    done = [outcome for outcome in outcomes if outcome.metrics is not None]
    page.add_text(f"{len(done)} of {len(outcomes)} runs are finished.")
    for outcome in outcomes:
        if outcome.problem:
            page.add_text(f"{outcome.run.name} failed: {outcome.problem}")
    if not SIZES[request.size].shows_quality:
        page.add_text(ONLY_RUNS)
    shown = request.list_experiments()
    for experiment in shown:
        _add_experiment(page, results, experiment)
    if left_out := [n for n in NAMES if n not in {e.name for e in shown}]:
        page.add_text(f"Not asked for here: {', '.join(left_out)}.")
    return page


def _add_experiment(page: Page, results: Results, experiment: Experiment) -> None:
    figures = page.folder / "figures" / experiment.name
    page.add_heading(experiment.title)
    page.add_text(f"{experiment.question} Paper: {experiment.table.place}.")
    categories = results.request.list_categories(experiment)
    for category in [*categories, *[MEAN] * (len(categories) > 1)]:
        page.add_table(*tabulate(results, experiment, category))
    page.add_text(say_difference(results, experiment))
    for remark in experiment.table.remarks:
        page.add_text(remark)
    if experiment.name in ("known_pose", "unknown_pose"):
        page.add_text(OTHER_SYSTEMS)
    analysis = analyze(results, experiment, figures)
    if analysis.problem:
        page.add_text(f"Not analysed: {analysis.problem}")
    if analysis.measures:
        page.add_table(("Measure", "Value"), list_measures(analysis))
    for path, caption in (
        *_draw_run_times(results, experiment, figures),
        *_copy_pictures(results, experiment, figures),
        *analysis.figures,
    ):
        page.add_figure(path, caption)


def say_difference(results: Results, experiment: Experiment) -> str:
    """The sentence on how a table's runs differ from the paper's."""
    done = results.list_finished(experiment)
    if not done:
        return "None of its runs is finished yet."
    steps = _join(o.config.train.steps for o in done if o.config)
    trained, tested = (
        _join((o.metrics or {}).get(name) for o in done)
        for name in ("train_models", "test_models")
    )
    return (
        f"What differs: ours are trained on {SOURCES[results.request.source.kind]}, "
        f"{trained} models a category, tested on {tested} others, in {steps} steps; "
        "the paper's on ShapeNet's thousands of models a category, in 600,000 steps."
    )


def _join(values: Iterator) -> str:
    """Distinct numbers in order: "2,000 and 4,000"."""
    found = sorted({value for value in values if value is not None})
    return " and ".join(f"{value:,}" for value in found)


def tabulate(
    results: Results, experiment: Experiment, category: str
) -> tuple[list[str], list[list[str]]]:
    """The table of an experiment: a line for each row.

    Args:
      category: one, or "mean" of those that there are.

    Returns:
      The heads of the columns, and the cells.
    """
    heads, columns = [category], [[row.label for row in experiment.rows]]
    for metric in experiment.metrics:
        heading = get_metric(metric).heading
        paper = [
            results.find_published(experiment, row, category, metric)
            for row in experiment.rows
        ]
        ours = [
            format_metric(metric, results.find_mean(experiment, row, metric))
            if category == MEAN
            else results.make_group(row, category).describe(metric)
            for row in experiment.rows
        ]
        is_published = any(value is not None for value in paper)
        if is_published:
            heads.append(f"{heading}, paper")
            columns.append([format_metric(metric, value) for value in paper])
        if is_published or set(ours) != {MISSING}:  # others have no number
            heads.append(f"{heading}, ours")
            columns.append(ours)
    rows = [list(cells) for cells in zip(*columns, strict=True)]
    if category == MEAN:
        return heads, rows
    costs = [_describe_cost(results, row, category) for row in experiment.rows]
    heads += ["Runs", "Minutes", "Memory (GB)"]
    return heads, [a + b for a, b in zip(rows, costs, strict=True)]


def _describe_cost(results: Results, row: Row, category: str) -> list[str]:
    """Runs, minutes of training and memory."""
    if absence := results.request.explain_absence(row):
        return [absence, "", ""]
    outcomes = results.list_outcomes(row, category)
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


def _draw_run_times(results: Results, experiment: Experiment, folder: Path) -> Figures:
    """Validation over training time, a figure per category and a line per run."""
    if experiment.name not in ("known_pose", "unknown_pose", "color", "depth"):
        return []
    drawn = []
    for category in results.request.list_categories(experiment):
        groups = []
        for row in experiment.rows:
            runs = [
                ComparedRun(o.run.name, records=_read_records(o.workdir))
                for o in results.list_outcomes(row, category)
                if o.metrics is not None
            ]
            groups += [Group(row.label, tuple(runs))] if runs else []
        if groups:
            path = folder / f"{category}_time.png"
            draw_comparison(groups, path)
            caption = f"{category}: validation over minutes of training."
            drawn.append((path, caption))
    return drawn


def _read_records(workdir: Path):
    return tuple(MetricLog(workdir / "metrics.jsonl").read())


def _copy_pictures(results: Results, experiment: Experiment, folder: Path) -> Figures:
    """Small copies of the pictures in the reports of each row's first run."""
    drawn = []
    for category in results.request.list_categories(experiment)[:1]:
        for row in experiment.rows if experiment.picture else ():
            for outcome in results.list_outcomes(row, category)[:1]:
                path = outcome.workdir / "report" / experiment.picture
                if outcome.metrics is not None and path.is_file():
                    copy = folder / f"{outcome.run.name}.webp"
                    text = f"{row.label}: test views of the {category}s, first seed."
                    drawn.append((_copy_small(path, copy), text))
    return drawn


def _copy_small(path: Path, copy: Path) -> Path:
    """The picture as WebP, at most as wide as a column of the page."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(path) as opened:
        image = opened.convert("RGB")
    image.thumbnail((_WIDTH, _WIDTH * 10), Image.Resampling.LANCZOS)
    image.save(copy, format="WEBP", quality=82)
    return copy
