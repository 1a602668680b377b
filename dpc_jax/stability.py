"""Stiff and extreme cases: python -m dpc_jax.stability [--quick] [--subjects=...]

Compares every public function with an oracle where it may break, and writes
stability.md and stability.json into the folder of --out. Ends with status 1 if anything
is outside its stated tolerance.
"""

import argparse
import shlex
import sys
import time
from pathlib import Path

from dpc_jax.measure.stability import QUICK_DTYPES, SUBJECTS
from dpc_jax.task import FlagParser, Task, reading_names, run_command

WRITES = ("stability.md", "stability.json")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, measure, write the report; returns the exit status.

    It is 1 where anything is outside its tolerance, too.
    """
    return run_command(lambda: _read(arguments))


def _read(arguments):
    words = sys.argv[1:] if arguments is None else arguments
    options = make_parser().parse_args(words)
    command = shlex.join(["python", "-m", "dpc_jax.stability", *words])
    return Task(
        lambda: _measure(options, command),
        out=options.out,
        interrupted=f"Interrupted; finished subjects are in {options.out}.",
        writes=WRITES,
    )


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("stability", description="What happens in extreme cases.")
    add = parser.add_argument
    add("--out", type=Path, default=Path("runs/stability"), help="folder (%(default)s)")
    text = "a small version of each subject, in a few minutes; the cases in "
    add("--quick", action="store_true", help=text + ",".join(QUICK_DTYPES))
    text = f"some of {','.join(SUBJECTS)}; default: all"
    add("--subjects", type=reading_names(SUBJECTS), default=SUBJECTS, help=text)
    return parser


def run_subject(subject: str, *, quick: bool) -> list:
    """Rows of a subject, or of a small version of it."""
    # Heavy: flags are read first.
    from dpc_jax.measure.stability import descents, functions, images, random_draws
    from dpc_jax.measure.stability.runner import run_cases

    if subject == "random":
        return [random_draws.run(t, quick=quick) for t in random_draws.TARGETS]
    if subject == "descent":
        return list(descents.run(quick=quick))
    cases = (functions.CASES | images.CASES)[subject]
    return list(run_cases(subject, cases, quick=quick))


def _measure(options, command):
    """Run subject by subject, and print what failed; the exit status."""
    from dpc_jax.measure.stability.report import write_report

    options.out.mkdir(parents=True, exist_ok=True)
    rows, seconds, path = [], {}, None
    # In the order of the report, whatever the order of the flag.
    wanted = [name for name in SUBJECTS if name in options.subjects]
    for step, subject in enumerate(wanted, start=1):
        start = time.perf_counter()
        found = run_subject(subject, quick=options.quick)
        seconds[subject] = time.perf_counter() - start
        rows += found
        print(f"{step}/{len(wanted)} {subject}: {len(found)} rows", flush=True)
        # After each one, so that an interrupted run keeps those that are done.
        path = write_report(options.out, rows, seconds=seconds, command=command)
    failures = [row.describe_failure() for row in rows if not row.passes]
    for failure in failures:
        print(f"Outside tolerance: {failure}")
    outcome = f"{len(failures)} outside" if failures else "All within"
    print(f"{outcome} tolerance.")
    print(f"Report: {path}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
