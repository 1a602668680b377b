"""The report: stability.md, and stability.json with every row."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from dpc_jax.files import write_json, write_text
from dpc_jax.measure.stability.runner import Row
from dpc_jax.measure.timing import describe_machine, phrase_machine
from dpc_jax.reporting.tables import format_table


def write_report(
    out: Path, rows: Sequence[Row], *, seconds: Mapping[str, float], command: str
) -> Path:
    """Write the report into a folder that exists, and return the path of stability.md.

    Args:
      seconds: wall times by subject.
      command: repeats the run.
    """
    machine = describe_machine()
    failures = [row.describe_failure() for row in rows if not row.passes]
    data = {
        "passes": not failures,
        "command": command,
        "seconds": seconds,
        "machine": machine,
        "failures": failures,
        "rows": [dataclasses.asdict(row) | {"passes": row.passes} for row in rows],
    }
    write_json(out / "stability.json", data)
    blocks = [
        "# Stability on stiff and extreme cases",
        f"{len(rows) - len(failures)} of {len(rows)} rows are within tolerance.",
        *(["**Outside tolerance:**"] if failures else []),
        "\n".join(f"- {failure}" for failure in failures),
        f"{phrase_machine(machine)}.",
        f"To repeat it: `{command}`",
        "Each case runs under `vmap` and, but in the quick form, alone, with the "
        "gradient to every input, against an oracle in long double. Errors are "
        "relative to the largest magnitude of the output. *Worst* is error over "
        "tolerance: at most 1 passes. *Finite only* counts results that only have to "
        "be finite. Every row is in stability.json; the values at kinks and limits are "
        "those of docs/numerics.md.",
        _summarize(rows),
        "Wall time (s): " + ", ".join(f"{k} {v:.0f}" for k, v in seconds.items()) + ".",
    ]
    page = "\n\n".join(block.strip("\n") for block in blocks if block) + "\n"
    return write_text(out / "stability.md", page)


def _summarize(rows) -> str:
    """A line for each subject and dtype."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.subject, row.dtype), []).append(row)
    lines = []
    for key, group in groups.items():
        failed = sum(not row.passes for row in group)
        finite = sum(
            all(math.isinf(most) for _, most in row.errors.values()) for row in group
        )
        worst = max(group, key=lambda row: row.worst)
        lines.append(
            (*key, len(group), failed, finite, f"{worst.worst:.2g}", worst.case)
        )
    head = ("subject", "dtype", "rows", "outside", "finite only", "worst")
    return format_table((*head, "nearest to its limit"), lines)
