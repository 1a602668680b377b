"""The page of DIR: tables with the paper's numbers beside ours, figures, targets."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from dpc_jax.experiments.analyses import Analysis
from dpc_jax.experiments.catalogue import NAMES
from dpc_jax.experiments.declarations import Experiment
from dpc_jax.experiments.published import TITLE
from dpc_jax.experiments.report.blocks import (
    Block,
    Figure,
    Heading,
    Items,
    Paragraph,
    write_html,
    write_markdown,
)
from dpc_jax.experiments.report.figures import draw_figures
from dpc_jax.experiments.report.measures import make_measures
from dpc_jax.experiments.report.pictures import copy_pictures
from dpc_jax.experiments.report.tables import Table, make_table
from dpc_jax.experiments.report.targets import Target, check_targets
from dpc_jax.experiments.results import Results
from dpc_jax.experiments.sizes import SIZES
from dpc_jax.experiments.systems import SHARED, list_systems
from dpc_jax.files import replacing, write_text

ONLY_RUNS = (
    "These runs have a few steps and tiny networks. They show that every experiment "
    "runs to its end; their figures say nothing about how well, and targets are left "
    "out. --size=cpu and --size=full have figures that count."
)
Analyses = Mapping[str, Analysis]  # by experiment
CAPTIONS = {  # of the analyses' figures
    "projection_error.png": "Projection error against the number of points: mean and "
    "single runs.",
    "silhouettes.png": "Input, true silhouette, and what the fewest points of each "
    "kind render.",
    "ellipsoids.png": "The Gaussians of the same shapes as ellipsoids, all seen from "
    "one side; a point has one colour in a row.",
    "correspondences.png": "Keypoints on a template, and where points of the same "
    "index are on other chairs.",
    "correspondences_parts.png": "Share of transferred points on the right part, by "
    "keypoint.",
    "interpolation.png": "Frames between two test images, mixed in the first shared "
    "layer.",
    "interpolation.gif": "The same, moving.",
}


def make_blocks(results: Results, analyses: Analyses, *, figures: Path) -> list[Block]:
    """The page as blocks; figures are drawn into a folder.

    Args:
      results: all that was asked for.
      analyses: what was made of finished runs.
      figures: folder.
    """
    measured = {name: found.metrics for name, found in analyses.items()}
    blocks: list[Block] = [Heading(TITLE, 1)]
    blocks += _introduce(results)
    if not all(SIZES[request.size].shows_quality for request in results.requests):
        blocks.append(Paragraph(ONLY_RUNS))
    elif targets := check_targets(results, measured):
        blocks += [Heading("Targets"), _list_targets(targets)]
    for experiment in results.list_experiments():
        blocks += _describe(results, experiment, analyses, figures)
    left_out = set(NAMES) - {e.name for e in results.list_experiments()}
    if left_out:
        names = ", ".join(name for name in NAMES if name in left_out)
        blocks.append(Paragraph(f"Not asked for here: {names}."))
    return blocks


def _introduce(results: Results) -> Iterator[Block]:
    yield Paragraph(
        "Insafutdinov and Dosovitskiy, Unsupervised Learning of Shape and Pose with "
        "Differentiable Point Clouds (NeurIPS 2018). The paper's numbers are of "
        "ShapeNet after 600,000 steps; ours are of the runs listed, and each table "
        "says how these differ. So compare rows within a column, not the columns. "
        "Ours are mean ± standard deviation over n seeds; one run has no spread. "
        "Minutes are wall clock, beside whatever else the machine did."
    )
    commands = [f"`{request.write_command()}`" for request in results.requests]
    yield Paragraph(f"Made by {', '.join(commands)}.")
    outcomes = {
        o.run.name: o for e in results.list_experiments() for o in results.list_all(e)
    }
    done = [o for o in outcomes.values() if o.metrics is not None]
    yield Paragraph(f"{len(done)} of {len(outcomes)} runs are finished.")
    names_by_problem: dict[str, list[str]] = {}
    for outcome in outcomes.values():
        if outcome.problem:
            names = names_by_problem.setdefault(outcome.problem, [])
            names.append(outcome.run.name)
    if names_by_problem:
        yield Items(
            [f"{', '.join(n)} failed: {text}" for text, n in names_by_problem.items()]
        )


def _list_targets(targets: Sequence[Target]) -> Table:
    words = {True: "met", False: "not met", None: "runs are missing"}
    rows = [(t.experiment, t.text, t.reached, words[t.met]) for t in targets]
    return Table(("Experiment", "Target", "Figures", ""), rows)


def _describe(results, experiment, analyses, figures) -> Iterator[Block]:
    yield Heading(experiment.title)
    yield Paragraph(f"{experiment.question} Paper: {experiment.table.place}.")
    yield make_table(results, experiment)
    yield Paragraph(say_difference(results, experiment))
    if experiment.table.remarks:
        yield Items(experiment.table.remarks)
    if systems := list_systems([row.variant or "" for row in experiment.rows]):
        yield Paragraph(SHARED)
        yield Items([system.describe() for system in systems])
    drawn = draw_figures(results, experiment, figures)
    if experiment.picture:
        drawn += copy_pictures(results, experiment, figures)
    for path, caption in drawn:
        yield Figure(path, caption)
    analysis = analyses.get(experiment.name)
    if analysis:
        yield from _show_analysis(experiment, analysis)


def _show_analysis(experiment: Experiment, analysis: Analysis) -> Iterator[Block]:
    if analysis.problem:
        yield Paragraph(f"Not made: {analysis.problem}")
        return
    if measures := make_measures(experiment.name, analysis):
        yield measures
    for path in analysis.figures:
        yield Figure(path, CAPTIONS.get(path.name, path.stem.replace("_", " ")))


def say_difference(results: Results, experiment: Experiment) -> str:
    """The sentence on how a table's runs differ from the paper's, by their configs."""
    done = [o.metrics for o in results.list_all(experiment) if o.metrics]
    if not done:
        return "None of its runs is finished yet."
    kinds = {request.source.kind for request in results.requests}
    data = {
        "procedural": "procedural shapes",
        "open": "open meshes",
        "shapenet": "ShapeNet",
        "renders": "the renders published with the paper",
    }
    steps = _join(results.collect(experiment, lambda config: config.train.steps))
    trained = _join(metrics.get("train_models") for metrics in done)
    tested = _join(metrics.get("test_models") for metrics in done)
    sources = " and ".join(data[kind] for kind in sorted(kinds))
    return (
        f"What differs: ours are trained on {sources}, {trained} models a category, "
        f"tested on {tested} others, in {steps} steps; the paper's on ShapeNet's "
        "thousands of models a category, in 600,000 steps."
    )


def _join(values) -> str:
    """Distinct numbers in order: "2,000 and 4,000"."""
    found = sorted({value for value in values if value is not None})
    shown = [f"{value:,}" for value in found]
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))


def write_page(folder: Path, blocks: Sequence[Block]) -> Path:
    """Write index.html and paper.md, each whole; the path of the first."""
    pictures = [block.path for block in blocks if isinstance(block, Figure)]
    places = {path: path.relative_to(folder).as_posix() for path in pictures}
    write_text(folder / "paper.md", write_markdown(blocks, places))
    return write_text(folder / "index.html", write_html(blocks, TITLE))


def publish(page: Path, blocks: Sequence[Block]) -> Path:
    """Write the Markdown elsewhere, its figures into images/NAME/ beside it."""
    folder = page.parent / "images" / page.stem
    names: dict[bytes, str] = {}
    places = {}
    for path in (block.path for block in blocks if isinstance(block, Figure)):
        # Two experiments may draw different figures of one name, each in its own
        # folder, or the same figure.
        content = path.read_bytes()
        name = names.setdefault(content, f"{path.parent.name}-{path.name}")
        with replacing(folder / name) as temporary:
            temporary.write_bytes(content)
        places[path] = f"images/{page.stem}/{name}"
    return write_text(page, write_markdown(blocks, places))
