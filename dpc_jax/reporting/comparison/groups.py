"""Runs in groups that differ in the seed alone, and what sets the groups apart."""

import collections
import math
import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from dpc_jax.evaluation.metrics import MISSING, format_metric, get_metric


@dataclass(frozen=True)
class ComparedRun:
    """One run, as far as a comparison shows it.

    Attributes:
      name: that no other run has.
      seed: of the run.
      fields: its settings but for the seed, by name ("train.steps").
      metrics: of its report; none where it is not finished.
      records: lines of its `metrics.jsonl`.
      unfinished: how far it is, where it is not finished; else "".
    """

    name: str
    seed: int = 0
    fields: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    records: Sequence[Mapping[str, Any]] = ()
    unfinished: str = ""


class Summary(NamedTuple):
    """Mean of a measure over seeds; the standard deviation (n - 1), None of one."""

    mean: float
    spread: float | None


@dataclass(frozen=True)
class Group:
    """Runs of the same settings.

    Attributes:
      name: of the runs, without the seed.
      runs: by seed.
      differs: the settings that most other groups have otherwise.
    """

    name: str
    runs: tuple[ComparedRun, ...]
    differs: Mapping[str, Any] = field(default_factory=dict)

    def summarize(self, metric: str) -> Summary | None:
        """The measure over the finished runs that have it; None where none has."""
        found = [run.metrics.get(metric) for run in self.runs]
        values = [
            float(v) for v in found if isinstance(v, int | float) and math.isfinite(v)
        ]
        if not values:
            return None
        spread = statistics.stdev(values) if len(values) > 1 else None
        return Summary(statistics.fmean(values), spread)

    def describe(self, metric: str) -> str:
        """The measure as people read it: "91.0 ± 0.4"."""
        summary = self.summarize(metric)
        if summary is None:
            return MISSING
        mean = format_metric(metric, summary.mean)
        if summary.spread is None:
            return mean
        return f"{mean} ± {format_metric(metric, summary.spread)}"


def group_runs(runs: Iterable[ComparedRun]) -> list[Group]:
    """Groups of runs with equal settings, in the order in which they come."""
    found: dict[tuple, list[ComparedRun]] = {}
    for run in runs:
        key = tuple(sorted((name, repr(value)) for name, value in run.fields.items()))
        found.setdefault(key, []).append(run)
    common = find_common([members[0].fields for members in found.values()])
    groups = []
    for members in found.values():
        ordered = tuple(sorted(members, key=lambda run: (run.seed, run.name)))
        fields = ordered[0].fields
        differs = {n: v for n, v in fields.items() if n in common and v != common[n]}
        groups.append(Group(_strip_seed(ordered), ordered, differs))
    return groups


def find_common(settings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The settings that are not the same everywhere, with their most frequent value.

    Of values that are equally frequent it is the one that comes first.
    """
    common = {}
    for name in dict.fromkeys(name for fields in settings for name in fields):
        counts = collections.Counter(repr(fields.get(name)) for fields in settings)
        if len(counts) > 1:
            most = max(counts, key=lambda text: counts[text])
            values = (fields.get(name) for fields in settings)
            common[name] = next(value for value in values if repr(value) == most)
    return common


def _strip_seed(runs: Sequence[ComparedRun]) -> str:
    return re.sub(r"-?seed\d+$", "", runs[0].name) or runs[0].name


def find_best(groups: Sequence[Group], metric: str) -> Group | None:
    """The group of the best mean; None where there is nothing to choose from."""
    better = get_metric(metric).higher_is_better
    means = {
        i: s.mean
        for i, g in enumerate(groups)
        if (s := g.summarize(metric)) is not None
    }
    if better is None or len(set(means.values())) < 2:
        return None
    choose = max if better else min
    return groups[choose(means, key=lambda i: means[i])]
