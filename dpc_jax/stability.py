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

from dpc_jax.measure.stability import DTYPES, SUBJECTS
from dpc_jax.task import FlagParser, Task, reading_names, run_command

QUICK_DTYPES = ("float32",)
WRITES = ("stability.md", "stability.json")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run the subjects, write the report.

    Returns:
      The exit status: 0, 1 if anything is outside its tolerance or cannot be written, 2
      for a wrong flag, 130 after Ctrl-C.
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
    parser.add_argument(
        "--out", type=Path, default=Path("runs/stability"), help="folder (%(default)s)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a small version of each subject, in a few minutes; the cases in "
        f"{','.join(QUICK_DTYPES)} unless --dtypes says otherwise",
    )
    for flag, known in (("subjects", SUBJECTS), ("dtypes", DTYPES)):
        words = f"some of {','.join(known)}; default: all"
        parser.add_argument(f"--{flag}", type=reading_names(known), help=words)
    parser.add_argument("--seed", type=int, default=0, help="of the random draws")
    return parser


def _measure(options, command):
    """Run subject by subject, and print what failed; the exit status."""
    # Heavy: flags are read first.
    from dpc_jax.learning.training.progress import ProgressReport
    from dpc_jax.measure.stability.report import write_report
    from dpc_jax.measure.stability.runner import run_subject
    from dpc_jax.measure.timing import describe_machine

    options.out.mkdir(parents=True, exist_ok=True)
    rows, seconds, path = [], {}, None
    about = {"seed": options.seed, "command": command}
    about["machine"] = describe_machine()
    # In the order of the report, whatever the order of the flag.
    subjects = [name for name in SUBJECTS if name in (options.subjects or SUBJECTS)]
    wanted = {"quick": options.quick, "seed": options.seed}
    wanted["dtypes"] = options.dtypes or (QUICK_DTYPES if options.quick else None)
    with ProgressReport("Stability", total=len(subjects)) as progress:
        for step, subject in enumerate(subjects, start=1):
            start = time.perf_counter()
            found = run_subject(subject, **wanted)
            seconds[subject] = time.perf_counter() - start
            rows += found
            progress.tell(f"{step}/{len(subjects)} {subject}: {len(found)} rows")
            # After each one, so that an interrupted run keeps those that are done.
            path = write_report(options.out, rows, seconds=seconds, **about)
            progress.advance(step)
    failures = [row.describe_failure() for row in rows if not row.passes]
    for failure in failures:
        print(f"Outside tolerance: {failure}")
    num_failed = len(failures)
    print(f"{num_failed} outside tolerance." if failures else "All within tolerance.")
    print(f"Report: {path}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
