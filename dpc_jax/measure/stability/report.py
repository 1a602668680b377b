"""stability.md and stability.json: the run and its machine, failures, every part."""

import importlib.metadata
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dpc_jax.files import write_json, write_text
from dpc_jax.measure.stability.report_parts import PartResult
from dpc_jax.reporting.tables import format_table

_LIBRARIES = ("dpc_jax", "jax", "jaxlib", "numpy", "flax", "optax")


def write_report(
    out: Path,
    results: Mapping[str, PartResult],
    *,
    machine: Mapping[str, Any],
    seconds: Mapping[str, float],
    seed: int,
    command: str,
) -> Path:
    """Write OUT/stability.json and OUT/stability.md, and return the path of the latter.

    Results and wall times are by part; the command repeats the run.
    """
    versions = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    data = {
        "passes": all(result.passes for result in results.values()),
        "command": command,
        "seed": seed,
        "seconds": dict(seconds),
        "machine": dict(machine),
        "versions": versions,
        "failures": [f for result in results.values() for f in result.failures],
        "parts": {name: result.data for name, result in results.items()},
    }
    write_json(out / "stability.json", data)
    head = _describe_run(results, machine, versions, seconds, seed, command)
    sections = [result.markdown.rstrip() + "\n" for result in results.values()]
    return write_text(out / "stability.md", "\n".join([head, *sections]))


def _describe_run(results, machine, versions, seconds, seed, command):
    failed = [name for name, result in results.items() if not result.passes]
    verdict = (
        f"**Outside tolerance: {', '.join(failed)}.**"
        if failed
        else "Everything below is within its stated tolerance."
    )
    flags = ", ".join(machine["flags"]) or "no flags of note"
    rows = [
        (name, "yes" if result.passes else "**no**", f"{seconds[name]:.0f}")
        for name, result in results.items()
    ]
    parts = format_table(("part", "passes", "wall time (s)"), rows)
    lines = [
        "# Stability on stiff and extreme cases",
        "",
        verdict,
        "",
        f"{machine['processor']} ({flags}), {machine['cores']} of its cores, "
        f"{machine['system']}, {machine['backend']}; Python {machine['python']}, "
        f"{', '.join(f'{name} {version}' for name, version in versions.items())}; seed "
        f"{seed}.",
        "",
        f"To repeat it: `{command}`",
        "",
        parts,
    ]
    return "\n".join(lines)
