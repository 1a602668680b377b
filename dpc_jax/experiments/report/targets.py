"""What the runs must show, checked from their figures."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.report.tables import format_value
from dpc_jax.experiments.results import Results
from dpc_jax.experiments.signals import COLORED, DEEP

_BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}
MORE_ACCURATE = 0.25  # accuracy of the ensemble over one regressor
LESS_BY_DEPTH = 0.10  # share of the Chamfer distance
COST_OF_COLOR = 0.05  # share of the Chamfer distance
ON_RIGHT_PART = 0.7  # share of transferred points
FEW_POINTS = (20, 60, 200)
_DEFAULTS = "Ours, defaults of this package"  # a row


@dataclasses.dataclass(frozen=True)
class Target:
    """A statement about the figures.

    Attributes:
      experiment: that it is about.
      text: what must hold.
      reached: the figures.
      met: None where runs are missing.
    """

    experiment: str
    text: str
    reached: str
    met: bool | None


Analyses = Mapping[str, Mapping[str, Any]]  # metrics by experiment


def check_targets(results: Results, analyses: Analyses) -> list[Target]:
    """All targets of the experiments and categories that were asked for."""
    asked = {e.name for e in results.list_experiments()}
    reader = _Reader(results, analyses)
    found = [target for check in _CHECKS for target in check(reader)]
    return [target for target in found if target.experiment in asked]


class _Reader:
    """Means of rows, by experiment, label and category."""

    def __init__(self, results: Results, analyses: Analyses):
        self.results, self.analyses = results, analyses

    def list_categories(self, experiment: str) -> list[str]:
        return self.results.list_categories(_BY_NAME[experiment])

    def read(self, experiment, label, category, metric="chamfer") -> float:
        """The mean over seeds; NaN where there is none."""
        declared = _BY_NAME[experiment]
        row = find_row(declared, label)
        summary = self.results.summarize(declared, row, category, metric)
        return math.nan if summary is None else summary.mean


def find_row(experiment: Experiment, label: str) -> Row:
    """The row of a label."""
    return next(row for row in experiment.rows if row.label == label)


def _state(experiment, text, metric, values: Sequence[float], holds: Callable):
    """A target on values; open where one of them is missing."""
    shown = [format_value(metric, None if math.isnan(v) else v) for v in values]
    met = None if any(map(math.isnan, values)) else bool(holds(*values))
    return Target(experiment, text, ", ".join(shown), met)


def _check_known_pose(reader) -> Iterator[Target]:
    name, rows = "known_pose", ("Ours, 32²", "Ours, 64²", "Ours, 128²")
    for category in reader.list_categories(name):
        yield _state(
            name,
            f"{category}: Chamfer falls from 32 to 64 to 128",
            "chamfer",
            [reader.read(name, row, category) for row in rows],
            lambda low, middle, high: low > middle > high,
        )
        if category in reader.list_categories("unknown_pose"):
            known = reader.read(name, "Ours, 64²", category)
            unknown = reader.read("unknown_pose", "Ours", category)
            text = f"{category}: Chamfer with known pose at 64 below unknown pose"
            values = [known, unknown]
            yield _state(name, text, "chamfer", values, lambda k, u: k < u)


def _check_unknown_pose(reader) -> Iterator[Target]:
    name = "unknown_pose"
    for category in reader.list_categories(name):
        naive, ours, defaults, labels = (
            reader.read(name, label, category, "pose_accuracy")
            for label in ("Ours-naive", "Ours", _DEFAULTS, "GT pose")
        )
        for whose, ensemble in (("ours", ours), ("defaults", defaults)):
            yield _state(
                name,
                f"{category}: accuracy of the ensemble at least "
                f"{100 * MORE_ACCURATE:.0f} points above naive (naive, {whose})",
                "pose_accuracy",
                [naive, ensemble],
                lambda one, many: many - one >= MORE_ACCURATE,
            )
        yield _state(
            name,
            f"{category}: GT pose is the upper bound of the accuracy (ours, GT pose)",
            "pose_accuracy",
            [ours, labels],
            lambda found, bound: bound >= found,
        )


def _check_ablation(reader) -> Iterator[Target]:
    name = "ablation"
    table = _BY_NAME[name].table
    for category in reader.list_categories(name):
        rows = _BY_NAME[name].rows
        paper = {
            row.label: table.find(row.published, category, "chamfer") or math.nan
            for row in rows
        }
        ours = {row.label: reader.read(name, row.label, category) for row in rows}
        labels = sorted(paper, key=lambda label: paper[label])
        swapped = [
            f"{a} and {b}"
            for i, a in enumerate(labels)
            for b in labels[i + 1 :]
            if ours[a] > ours[b]
        ]
        pairs = len(labels) * (len(labels) - 1) // 2
        is_open = any(map(math.isnan, ours.values()))
        yield Target(
            name,
            f"{category}: rows in the order of the paper's Chamfer distances",
            "–"
            if is_open
            else f"{len(swapped)} of {pairs} pairs the other way round"
            + (f": {'; '.join(swapped)}" if swapped else ""),
            None if is_open else not swapped,
        )


def _check_color(reader) -> Iterator[Target]:
    name = "color"
    for category in reader.list_categories(name):
        for text, without, with_color in COLORED:
            rows = [without, with_color]
            yield _state(
                name,
                f"{category}: {text}, costs at most {100 * COST_OF_COLOR:.0f} % of "
                "Chamfer (without, with)",
                "chamfer",
                [reader.read(name, row, category) for row in rows],
                lambda plain, colored: colored <= (1 + COST_OF_COLOR) * plain,
            )
            if without.startswith("Known"):
                continue
            yield _state(
                name,
                f"{category}: {text}, raises the accuracy (without, with)",
                "pose_accuracy",
                [reader.read(name, row, category, "pose_accuracy") for row in rows],
                lambda plain, colored: colored > plain,
            )


def _check_depth(reader) -> Iterator[Target]:
    name = "depth"
    against = {"chamfer": "Chamfer", "visible_chamfer": "Chamfer of what is seen"}
    for category in reader.list_categories(name):
        for text, *rows in DEEP:
            for metric, what in against.items():
                yield _state(
                    name,
                    f"{category}, {text}: depth lowers {what} by at least "
                    f"{100 * LESS_BY_DEPTH:.0f} % (without, with)",
                    metric,
                    [reader.read(name, row, category, metric) for row in rows],
                    lambda plain, deep: deep <= (1 - LESS_BY_DEPTH) * plain,
                )


def _check_points(reader) -> Iterator[Target]:
    name, metric = "points", "projection_error"
    for category in reader.list_categories(name):
        for count in FEW_POINTS:
            kinds = ("hand-tuned σ", "learned σ", "learned covariance")
            labels = [f"{kind}, {count} points" for kind in kinds]
            yield _state(
                name,
                f"{category}, {count} points: projection error falls from hand-tuned σ "
                "to learned σ to learned covariance",
                metric,
                [reader.read(name, row, category, metric) for row in labels],
                lambda fixed, sigma, covariance: fixed > sigma > covariance,
            )


def _check_correspondences(reader) -> Iterator[Target]:
    name = "correspondences"
    if reader.list_categories(name):
        found = reader.analyses.get(name, {}).get("right_part")
        yield Target(
            name,
            f"at least {ON_RIGHT_PART} of the transferred points on the right part",
            "–" if found is None else f"{found:.2f}",
            None if found is None else found >= ON_RIGHT_PART,
        )


_CHECKS = (
    _check_known_pose,
    _check_unknown_pose,
    _check_ablation,
    _check_points,
    _check_color,
    _check_depth,
    _check_correspondences,
)
