"""The catalogue's rows as Markdown: what failed, a summary, limits, every case."""

import math
from collections.abc import Sequence

from dpc_jax.measure.stability.cases.case import DTYPES
from dpc_jax.measure.stability.cases.runner import Row


def find_ratio(error: float | None, tolerance: float | None) -> float | None:
    """Error over tolerance; None where there is no tolerance."""
    if error is None or tolerance is None:
        return None
    if tolerance == 0:
        return 0.0 if error == 0 else math.inf
    return error / tolerance


def find_worst_ratio(row: Row) -> float:
    """The larger of the value's and the gradient's; 0 where neither is judged."""
    ratios = (
        find_ratio(row.value_error, row.value_tolerance),
        find_ratio(row.gradient_error, row.gradient_tolerance),
    )
    return max((ratio for ratio in ratios if ratio is not None), default=0.0)


def describe_failure(row: Row) -> str:
    """One sentence on a row outside its tolerance."""
    reasons = []
    if not row.is_finite:
        reasons.append("a value or gradient is not finite")
    for name in ("value", "gradient"):
        error = getattr(row, f"{name}_error")
        tolerance = getattr(row, f"{name}_tolerance")
        ratio = find_ratio(error, tolerance)
        if ratio is not None and not ratio <= 1:
            reasons.append(
                f"the error of the {name} is {error:.2e}, the tolerance {tolerance:.2e}"
            )
    return f"{row.subject}, {row.case}, {row.dtype}: {' and '.join(reasons)}."


def write_section(rows: Sequence[Row], *, table: str) -> str:
    """Section of the report: failures, then the summary, then documented limits.

    Args:
      rows: of `runner.run_cases`.
      table: name of the file with all rows.
    """
    failed = [row for row in rows if not row.passes]
    lines = ["## Extreme cases", ""]
    if failed:
        lines += [f"**{len(failed)} of {len(rows)} rows are outside tolerance:**", ""]
        lines += [f"- {describe_failure(row)}" for row in failed]
    else:
        lines += [f"All {len(rows)} rows are within tolerance."]
    lines += [
        "",
        "Each case runs under `jit` and under `vmap`, with the gradient to every input,"
        " against an oracle in long double. Errors are relative to the largest "
        "magnitude of the output. *Worst* is error over tolerance: at most 1 passes. "
        "*Finite only*: cases of which 16 bits are asked no more than finite numbers. "
        f"Every case is in [{table}]({table}).",
        "",
        *_summarize(rows),
        "",
        *_list_limits(rows),
    ]
    return "\n".join(lines) + "\n"


def _summarize(rows):
    lines = [
        "| subject | dtype | cases | outside | finite only | worst value | worst "
        "gradient | nearest to its limit |",
        "|---|---|---:|---:|---:|---:|---:|---|",
    ]
    for subject in dict.fromkeys(row.subject for row in rows):
        for dtype in DTYPES:
            group = [r for r in rows if (r.subject, r.dtype) == (subject, dtype)]
            if not group:
                continue
            cells = []
            for name in ("value", "gradient"):
                ratios = [
                    find_ratio(
                        getattr(r, f"{name}_error"), getattr(r, f"{name}_tolerance")
                    )
                    for r in group
                ]
                ratios = [ratio for ratio in ratios if ratio is not None]
                cells.append(f"{max(ratios):.2g}" if ratios else "–")
            num_failed = sum(not r.passes for r in group)
            num_finite = sum(r.value_tolerance is None for r in group)
            worst = max(group, key=find_worst_ratio)
            name = worst.case if find_worst_ratio(worst) > 0 else "–"
            lines.append(
                f"| {subject} | {dtype} | {len(group)} | {num_failed} | {num_finite} | "
                f"{' | '.join(cells)} | {name} |"
            )
    return lines


def _list_limits(rows):
    limits = {}
    for row in rows:
        if row.limit:
            limits.setdefault((row.subject, row.limit), {})[row.case] = None
    if not limits:
        return []
    lines = ["| subject | documented limit | cases |", "|---|---|---|"]
    for (subject, limit), cases in limits.items():
        lines.append(f"| {subject} | {limit} | {'; '.join(cases)} |")
    return lines


def write_table(rows: Sequence[Row]) -> str:
    """All rows as Markdown, one table a subject."""
    lines = [
        "# Every case",
        "",
        "Errors are relative, tolerances in brackets; – where there is none.",
        "",
    ]
    for subject in dict.fromkeys(row.subject for row in rows):
        lines += [
            f"## {subject[0].upper()}{subject[1:]}",
            "",
            "| case | dtype | value error | gradient error | finite | passes | limit | "
            "where the tolerance comes from |",
            "|---|---|---:|---:|---|---|---|---|",
        ]
        for row in rows:
            if row.subject != subject:
                continue
            cells = [
                row.case,
                row.dtype,
                _format_pair(row.value_error, row.value_tolerance),
                _format_pair(row.gradient_error, row.gradient_tolerance),
                "yes" if row.is_finite else "**no**",
                "yes" if row.passes else "**no**",
                row.limit or "–",
                row.because,
            ]
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def _format_pair(error, tolerance):
    if error is None:
        return "–"
    limit = "–" if tolerance is None else f"{tolerance:.1e}"
    return f"{error:.1e} ({limit})"
