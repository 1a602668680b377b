"""The report: stability.md, and stability.json with every row."""

import dataclasses
import importlib.metadata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_jax.files import write_json, write_text
from dpc_jax.measure.stability import DTYPES, SUBJECTS
from dpc_jax.measure.stability.runner import Row
from dpc_jax.measure.timing import phrase_machine
from dpc_jax.reporting.tables import format_table

_LIBRARIES = ("dpc_jax", "jax", "jaxlib", "numpy", "flax", "optax")


def write_report(
    out: Path,
    rows: Sequence[Row],
    *,
    machine: Mapping[str, Any],
    seconds: Mapping[str, float],
    seed: int,
    command: str,
) -> Path:
    """Write the report into a folder that exists, and return the path of stability.md.

    Args:
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
    libraries = ", ".join(f"{name} {version}" for name, version in versions.items())
    blocks = [
        "# Stability on stiff and extreme cases",
        f"{len(rows) - len(failures)} of {len(rows)} rows are within tolerance.",
        *(["**Outside tolerance:**"] if failures else []),
        "\n".join(f"- {failure}" for failure in failures),
        f"{phrase_machine(machine)}; {libraries}; seed {seed}.",
        f"To repeat it: `{command}`",
        "Each case runs under `jit` and under `vmap` (in the quick form under `vmap`), "
        "with the gradient to every input, against an oracle in long double. Errors "
        "are relative to the largest magnitude of the output. *Worst* is error over "
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
    for row in sorted(rows, key=lambda row: DTYPES.index(row.dtype)):
        groups.setdefault((row.subject, row.dtype), []).append(row)
    lines = []
    for key in sorted(groups, key=lambda key: list(SUBJECTS).index(key[0])):
        group = groups[key]
        failed = sum(not row.passes for row in group)
        finite = sum(not row.ratios for row in group)
        worst = {row.case: max(row.ratios.values(), default=0) for row in group}
        nearest = max(worst, key=lambda case: worst[case])
        lines.append(
            (*key, len(group), failed, finite, f"{worst[nearest]:.2g}", nearest)
        )
    head = ("subject", "dtype", "rows", "outside", "finite only", "worst")
    return format_table((*head, "nearest to its limit"), lines)
