"""Runs side by side: python -m dpc_jax.compare RUN... [--out=DIR]

RUN is the folder of a run, or a folder of runs. Prints a table of their test metrics,
and writes DIR/index.html: the table with what differs in their settings, mean and
spread over seeds, and the curves of all runs.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.task import FlagParser, Task, run_command


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        "compare", takes="RUN...", description="Runs side by side, as a page."
    )
    add = parser.add_argument
    text = "folder of a run, or a folder of runs"
    add("workdirs", nargs="+", type=Path, metavar="RUN", help=text)
    text = "folder of the page (%(default)s)"
    add("--out", type=Path, default=Path("runs/comparison"), help=text)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, write the page; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    if options.out.suffix in (".png", ".html", ".svg"):
        raise ValueError(
            f"--out must be a folder, but it is {options.out}; the page in it is "
            "index.html, and the curves are curves.svg."
        )
    from dpc_jax.run.comparison import compare_runs  # heavy: flags are read first

    return Task(
        lambda: compare_runs(options.workdirs, options.out),
        out=options.out,
        interrupted="Interrupted; start again to write the page.",
        writes=("index.html", "curves.svg"),
    )


if __name__ == "__main__":
    sys.exit(main())
