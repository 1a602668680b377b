"""The report: stability.md, stability.json, cases.md, and pictures of every row."""

import dataclasses
import importlib.metadata
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.files import write_json, write_text
from dpc_jax.measure.stability import DTYPES
from dpc_jax.measure.stability.case import Row
from dpc_jax.measure.timing import phrase_machine
from dpc_jax.reporting import style
from dpc_jax.reporting.tables import format_table

ROWS_FIGURE, SUMS_FIGURE = "stability_rows.png", "stability_sums.png"
_LIBRARIES = ("dpc_jax", "jax", "jaxlib", "numpy", "flax", "optax")
_NONE = "–"


def write_report(
    out: Path,
    rows: Sequence[Row],
    *,
    section: str = "",
    machine: Mapping[str, Any],
    seconds: Mapping[str, float],
    seed: int,
    command: str,
) -> Path:
    """Write the report into a folder that exists, and return the path of stability.md.

    Args:
      section: Markdown on stiff optimisation, without its heading.
      machine: of `describe_machine`.
      seconds: wall times by subject.
      command: repeats the run.
    """
    versions = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    failures = [row.describe_failure() for row in rows if not row.passes]
    data = {
        "passes": not failures,
        "command": command,
        "seed": seed,
        "seconds": dict(seconds),
        "machine": dict(machine),
        "versions": versions,
        "failures": failures,
        "rows": [dataclasses.asdict(row) | {"passes": row.passes} for row in rows],
    }
    write_json(out / "stability.json", data)
    write_text(out / "cases.md", _write_rows(rows))
    libraries = ", ".join(f"{name} {version}" for name, version in versions.items())
    blocks = [
        "# Stability on stiff and extreme cases",
        _write_verdict(rows, failures),
        f"{phrase_machine(machine)}; {libraries}; seed {seed}.",
        f"To repeat it: `{command}`",
        "Each case runs under `jit` and under `vmap` (in the quick form under `vmap`), "
        "with the gradient to every input, against an oracle in long double. Errors "
        "are relative to the largest magnitude of the output. *Worst* is error over "
        "tolerance: at most 1 passes. *Finite only* counts results that only have to "
        "be finite. Every row is in [cases.md](cases.md).",
        _summarize(rows),
        *_draw(rows, out),
        "Wall time (s): " + ", ".join(f"{k} {v:.0f}" for k, v in seconds.items()) + ".",
        _list_limits(rows),
        *(["## Stiff optimisation", section] if section else []),
    ]
    page = "\n\n".join(block.strip("\n") for block in blocks if block) + "\n"
    return write_text(out / "stability.md", page)


def _write_verdict(rows, failures):
    verdict = f"{len(rows) - len(failures)} of {len(rows)} rows are within tolerance."
    if not failures:
        return verdict
    return f"{verdict}\n\n**Outside tolerance:**\n\n" + "\n".join(
        f"- {failure}" for failure in failures
    )


def _group(rows):
    """Rows by subject and dtype, in the order of both."""
    subjects = dict.fromkeys(row.subject for row in rows)
    for key in itertools.product(subjects, DTYPES):
        group = [row for row in rows if (row.subject, row.dtype) == key]
        if group:
            yield key, group


def _summarize(rows):
    lines = []
    for key, group in _group(rows):
        worst = max(group, key=lambda row: row.worst_ratio)
        num_failed = sum(not row.passes for row in group)
        num_finite_only = sum(row.value_tolerance is None for row in group)
        lines.append(
            (
                *(*key, len(group), num_failed, num_finite_only),
                _find_largest(row.value_ratio for row in group),
                _find_largest(row.gradient_ratio for row in group),
                worst.case if worst.worst_ratio > 0 else _NONE,
            )
        )
    head = ("subject", "dtype", "rows", "outside", "finite only", "worst value")
    return format_table((*head, "worst gradient", "nearest to its limit"), lines)


def _find_largest(ratios):
    judged = [ratio for ratio in ratios if ratio is not None]
    return f"{max(judged):.2g}" if judged else _NONE


def _list_limits(rows):
    limits: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        if row.limit:
            limits.setdefault((row.subject, row.limit), {})[row.case] = None
    if not limits:
        return ""
    lines = [(*key, "; ".join(cases)) for key, cases in limits.items()]
    return "## Documented limits\n\n" + format_table(
        ("subject", "documented limit", "cases"), lines
    )


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
                row.limit or _NONE,
                row.because,
            )
            for row in rows
            if row.subject == subject
        ]
        heads = (*head, "limit", "where the tolerance comes from")
        lines += [f"## {subject.capitalize()}", "", format_table(heads, cells)]
    return "\n".join(lines)


def _format_pair(error, tolerance):
    if error is None:
        return _NONE
    return f"{error:.1e} ({_NONE if tolerance is None else f'{tolerance:.1e}'})"


def _draw(rows, out):
    """Lines that show the figures, of which each is drawn where it shows something."""
    lines = []
    if any(row.worst_ratio > 0 for row in rows):
        draw_ratios(rows, out / ROWS_FIGURE)
        lines.append(f"![error over tolerance of every row]({ROWS_FIGURE})")
    if any(row.terms for row in rows):
        draw_sums(rows, out / SUMS_FIGURE)
        lines.append(f"![error of float32 over the length of a sum]({SUMS_FIGURE})")
    return lines


def draw_ratios(rows: Sequence[Row], path: Path) -> Path:
    """Error over tolerance of every row, a column for each subject."""
    subjects = list(dict.fromkeys(row.subject for row in rows))
    figure = style.make_figure(11.0, 4.2)
    axes = figure.subplots()
    for place, (dtype, color) in enumerate(zip(DTYPES, style.SERIES, strict=False)):
        # Below a thousandth of the tolerance nothing is in question.
        points = [
            (subjects.index(row.subject) + 0.2 * (place - 1.5), row.worst_ratio)
            for row in rows
            if row.dtype == dtype and row.worst_ratio > 0
        ]
        if points:
            x, y = np.array(points).T
            y = np.clip(y, 1e-3, 1e3)
            axes.plot(x, y, "o", color=color, ms=3, alpha=0.5, label=dtype)
    axes.axhline(1, color=style.INK, ls="--", lw=0.8, label="tolerance")
    axes.set_yscale("log")
    axes.set_xticks(range(len(subjects)), subjects)
    style.label_axes(axes, y_label="error over tolerance")
    axes.legend(fontsize=8, frameon=False, ncols=len(DTYPES) + 1, loc="lower left")
    return style.save_figure(figure, path)


def draw_sums(rows: Sequence[Row], path: Path) -> Path:
    """Errors of value and gradient over the number of terms, and √n dashed."""
    rows = [row for row in rows if row.terms]
    titles = list(dict.fromkeys(row.case.rpartition(": ")[0] for row in rows))
    figure = style.make_figure(11.0, 4.2)
    panels = style.make_panels(figure, 2, share=True)
    kinds = ("value_error", "gradient_error")
    for axes, kind in zip(panels, kinds, strict=True):
        for title, color in zip(titles, style.SERIES, strict=False):
            chosen = [row for row in rows if row.case.startswith(title)]
            sizes = [row.terms for row in chosen]
            errors = [max(getattr(row, kind) or 0, 1e-9) for row in chosen]
            axes.loglog(sizes, errors, "o-", ms=4, color=color, label=title)
        lengths = np.array(sorted({row.terms for row in rows}), float)
        root = 1e-7 * np.sqrt(lengths)
        axes.loglog(lengths, root, "--", color=style.MUTED, label=r"$\sqrt{n}$")
        title = kind.replace("_", " of float32: ").partition(":")[0]
        label = "n, the number of terms"
        style.label_axes(axes, title=title, x_label=label, grid="both")
    panels[0].set_ylabel("relative error", fontsize=9)
    panels[1].legend(fontsize=8, frameon=False)
    return style.save_figure(figure, path)
