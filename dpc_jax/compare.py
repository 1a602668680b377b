"""Runs side by side: python -m dpc_jax.compare runs/car-seed0 runs/car-naive-seed0

Prints a Markdown table of their test metrics, with the mean of runs that differ only in
the seed, and draws their error against run time into --out.
"""

import argparse
import json
import re
import sys
from pathlib import Path

import numpy as np

from dpc_jax.evaluation.metrics import COMPARED_METRICS, MISSING
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.reporting.figures import draw_curves
from dpc_jax.reporting.tables import tabulate_runs


def read_metrics(workdir: Path) -> dict[str, float]:
    """Test metrics of a finished run.

    Raises:
      ValueError: there is no report in the folder.
    """
    path = workdir / "report" / "metrics.json"
    if not path.is_file():
        raise ValueError(
            f"Expected the report of a finished run at {path}, but there is none; "
            "start the command that began the run again, which trains it to the end."
        )
    return json.loads(path.read_text(encoding="utf-8"))


def add_means(runs: dict[str, dict]) -> dict[str, dict]:
    """The runs; those that differ only in the seed are followed by their mean."""
    groups: dict[str, list[str]] = {}
    for name in runs:
        groups.setdefault(re.sub(r"-seed\d+$", "", name), []).append(name)
    rows = {}
    for group, names in groups.items():
        rows |= {name: runs[name] for name in names}
        if len(names) > 1:
            rows[f"{group}, mean of {len(names)}"] = {
                c: float(np.mean([runs[n][c] for n in names]))
                for c in COMPARED_METRICS
                if all(runs[n].get(c) is not None for n in names)
            }
    return rows


def name_absent(rows: dict[str, dict]) -> str:
    """What a dash in the table of these runs means; "" where there is none."""
    lacking = [
        run
        for run, metrics in rows.items()
        if any(metrics.get(name) is None for name in COMPARED_METRICS)
    ]
    if not lacking:
        return ""
    return (
        f"{MISSING} is absent: {', '.join(lacking)} had no truth to compare with, or "
        "was given the poses and predicted none."
    )


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, print the table, draw the curves; returns the status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "workdirs", nargs="+", type=Path, help="folders of finished runs"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/comparison.png"))
    options = parser.parse_args(arguments)
    try:
        runs = {folder.name: read_metrics(folder) for folder in options.workdirs}
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    rows = add_means(runs)
    print(tabulate_runs(rows, columns=COMPARED_METRICS))
    if absent := name_absent(rows):
        print(absent)
    records = {
        folder.name: MetricLog(folder / "metrics.jsonl").read()
        for folder in options.workdirs
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    print(f"Curves: {draw_curves(records, options.out)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
