"""Runs side by side: python -m dpc_jax.compare RUN... [--out=DIR]

RUN is the folder of a run, or a folder of runs. Prints a table of their test metrics,
and writes DIR/index.html: the table with what differs in their settings, mean and
spread over seeds, and the curves of all runs.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.evaluation.metrics import COMPARED_METRICS, MISSING
from dpc_jax.reporting.comparison.groups import group_runs
from dpc_jax.reporting.comparison.page import tabulate_groups, write_comparison
from dpc_jax.run.comparison import find_workdirs, read_runs
from dpc_jax.run.flags import FlagParser, run_command

_NAMED = 3  # runs that lack a figure


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        prog="python -m dpc_jax.compare", description="Runs side by side, as a page."
    )
    parser.add_argument(
        "workdirs",
        nargs="+",
        type=Path,
        metavar="RUN",
        help="folder of a run, or a folder of runs",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/comparison"),
        help="folder of the page (%(default)s)",
    )
    return parser


def name_absent(rows: dict[str, dict]) -> str:
    """What a dash in the table of these runs means; "" where there is none."""
    lacking = [
        run
        for run, metrics in rows.items()
        if any(metrics.get(name) is None for name in COMPARED_METRICS)
    ]
    if not lacking:
        return ""
    named = ", ".join(lacking[:_NAMED])
    if len(lacking) > _NAMED:
        named += f" and {len(lacking) - _NAMED} others"
    return (
        f"{MISSING} is absent: {named} had no truth to compare with, or "
        "was given the poses and predicted none."
    )


def compare_runs(workdirs: list[Path], out: Path):
    """Print the table, write the page.

    Raises:
      ValueError: where there are no runs, or what they hold cannot be read.
      OSError: where the page cannot be written.
    """
    runs = read_runs(find_workdirs(workdirs))
    groups = group_runs(runs)
    print(tabulate_groups(groups))
    if absent := name_absent({r.name: dict(r.metrics) for r in runs if r.metrics}):
        print(absent)
    for run in runs:
        if run.unfinished:
            print(f"{run.name} is not finished: {run.unfinished}.")
    print(f"Page: {write_comparison(out, groups)}")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, write the page; returns the exit status."""
    try:
        options = make_parser().parse_args(arguments)
        if options.out.suffix in (".png", ".html", ".svg"):
            raise ValueError(
                f"--out must be a folder, but it is {options.out}; the page in it is "
                "index.html, and the curves are curves.png."
            )
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    return run_command(
        lambda: compare_runs(options.workdirs, options.out),
        out=options.out,
        interrupted="Interrupted; start again to write the page.",
    )


if __name__ == "__main__":
    sys.exit(main())
