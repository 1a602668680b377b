"""The part of the report on extreme cases: summary, limits, and every case."""

import dataclasses
import itertools

from dpc_jax.files import write_text
from dpc_jax.measure.stability.cases.case import DTYPES
from dpc_jax.measure.stability.cases.catalogue import list_cases, run_subjects
from dpc_jax.measure.stability.cases.runner import MODES, Row
from dpc_jax.measure.stability.report_parts import (
    PartRequest,
    PartResult,
    start_section,
)
from dpc_jax.reporting.tables import format_table

TABLE = "cases.md"
NONE = "–"


def run_part(request: PartRequest) -> PartResult:
    """Run the catalogue, and write OUT/cases.md with a line for each case and dtype.

    The quick form runs under `vmap` alone.
    """
    rows = run_subjects(
        list_cases(request.subjects),
        dtypes=request.dtypes,
        modes=("vmap",) if request.quick else MODES,
        tell=request.tell,
    )
    write_text(request.out / TABLE, _write_rows(rows))
    failures = tuple(describe_failure(row) for row in rows if not row.passes)
    data = [dataclasses.asdict(row) for row in rows]
    return PartResult(_write_section(rows, failures), data, failures)


def describe_failure(row: Row) -> str:
    """One sentence on a row outside its tolerance."""
    reasons = [] if row.is_finite else ["a value or gradient is not finite"]
    for name, error, tolerance, ratio in (
        ("value", row.value_error, row.value_tolerance, row.value_ratio),
        ("gradient", row.gradient_error, row.gradient_tolerance, row.gradient_ratio),
    ):
        if ratio is not None and not ratio <= 1:
            reasons.append(
                f"the error of the {name} is {error:.2e}, the tolerance {tolerance:.2e}"
            )
    return f"{row.subject}, {row.case}, {row.dtype}: {' and '.join(reasons)}."


def _write_section(rows, failures):
    num_within = sum(row.passes for row in rows)
    lines = [
        *start_section("Extreme cases", failures),
        f"{num_within} of {len(rows)} rows are within tolerance.",
        "",
        "Each case runs under `jit` and under `vmap` (in the quick form under `vmap`), "
        "with the gradient to every input, against an oracle in long double. Errors "
        "are relative to the largest magnitude of the output. *Worst* is error over "
        "tolerance: at most 1 passes. *Finite only* counts cases whose results in 16 "
        f"bits only have to be finite. Every case is in [{TABLE}]({TABLE}).",
        "",
        _summarize(rows),
        _list_limits(rows),
    ]
    return "\n".join(lines)


def _summarize(rows):
    subjects = dict.fromkeys(row.subject for row in rows)
    lines = []
    for subject, dtype in itertools.product(subjects, DTYPES):
        group = [row for row in rows if (row.subject, row.dtype) == (subject, dtype)]
        if not group:
            continue
        worst = max(group, key=lambda row: row.worst_ratio)
        num_failed = sum(not row.passes for row in group)
        num_finite_only = sum(row.value_tolerance is None for row in group)
        lines.append(
            (
                *(subject, dtype, len(group), num_failed, num_finite_only),
                _find_largest(row.value_ratio for row in group),
                _find_largest(row.gradient_ratio for row in group),
                worst.case if worst.worst_ratio > 0 else NONE,
            )
        )
    head = ("subject", "dtype", "cases", "outside", "finite only", "worst value")
    return format_table((*head, "worst gradient", "nearest to its limit"), lines)


def _find_largest(ratios):
    judged = [ratio for ratio in ratios if ratio is not None]
    return f"{max(judged):.2g}" if judged else NONE


def _list_limits(rows):
    limits: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        if row.limit:
            limits.setdefault((row.subject, row.limit), {})[row.case] = None
    lines = [(*key, "; ".join(cases)) for key, cases in limits.items()]
    heads = ("subject", "documented limit", "cases")
    return format_table(heads, lines) if lines else ""


def _write_rows(rows):
    lines = ["# Every case", "", "Errors are relative, tolerances in brackets.", ""]
    head = ("case", "dtype", "value error", "gradient error", "finite", "passes")
    for subject in dict.fromkeys(row.subject for row in rows):
        cells = [
            (
                row.case,
                row.dtype,
                _format_pair(row.value_error, row.value_tolerance),
                _format_pair(row.gradient_error, row.gradient_tolerance),
                "yes" if row.is_finite else "**no**",
                "yes" if row.passes else "**no**",
                row.limit or NONE,
                row.because,
            )
            for row in rows
            if row.subject == subject
        ]
        heads = (*head, "limit", "where the tolerance comes from")
        title = f"{subject[0].upper()}{subject[1:]}"
        lines += [f"## {title}", "", format_table(heads, cells)]
    return "\n".join(lines)


def _format_pair(error, tolerance):
    if error is None:
        return NONE
    return f"{error:.1e} ({NONE if tolerance is None else f'{tolerance:.1e}'})"
