"""Runs in groups that differ in the seed alone, and what sets the groups apart."""

import collections
import math
import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from dpc_jax.evaluation.metrics import MISSING, format_metric


@dataclass(frozen=True)
class ComparedRun:
    """One run, as far as a comparison shows it."""

    name: str  # that no other run has
    seed: int = 0
    # Its settings but for the seed, by name ("train.steps").
    fields: Mapping[str, Any] = field(default_factory=dict)
    # Of its report; none where it is not finished.
    metrics: Mapping[str, Any] = field(default_factory=dict)
    records: Sequence[Mapping[str, Any]] = ()  # lines of its `metrics.jsonl`
    unfinished: str = ""  # how far it is, where it is not finished


class Summary(NamedTuple):
    """Mean of a measure over seeds, and its standard deviation (n - 1) for several."""

    mean: float
    spread: float | None


@dataclass(frozen=True)
class Group:
    """Runs of the same settings."""

    name: str  # of the runs, without the seed
    runs: tuple[ComparedRun, ...]  # by seed
    # The settings that most other groups have otherwise.
    differs: Mapping[str, Any] = field(default_factory=dict)

    def summarize(self, metric: str) -> Summary | None:
        """The measure over the finished runs that have it; None where none has."""
        values = [run.metrics.get(metric) for run in self.runs]
        numbers = [float(v) for v in values if isinstance(v, int | float)]
        numbers = [number for number in numbers if math.isfinite(number)]
        if not numbers:
            return None
        spread = statistics.stdev(numbers) if len(numbers) > 1 else None
        return Summary(statistics.fmean(numbers), spread)

    def describe(self, metric: str) -> str:
        """The measure as people read it: "91.0 ± 0.4"."""
        summary = self.summarize(metric)
        if summary is None:
            return MISSING
        shown = [format_metric(metric, v) for v in summary if v is not None]
        return " ± ".join(shown)


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
        first = ordered[0]
        name = re.sub(r"-?seed\d+$", "", first.name) or first.name
        fields = first.fields.items()
        differs = {n: v for n, v in fields if n in common and v != common[n]}
        groups.append(Group(name, ordered, differs))
    return groups


def find_common(settings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The settings that are not the same everywhere, with their most frequent value.

    Of values that are equally frequent it is the one that comes first.
    """
    common = {}
    for name in dict.fromkeys(name for fields in settings for name in fields):
        texts = [repr(fields.get(name)) for fields in settings]
        if len(set(texts)) > 1:
            most = collections.Counter(texts).most_common(1)[0][0]
            common[name] = settings[texts.index(most)].get(name)
    return common
