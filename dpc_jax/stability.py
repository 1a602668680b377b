"""Stiff and extreme cases: python -m dpc_jax.stability [--quick] [--parts=...]

Compares every public function with an oracle where it may break, and writes
stability.md, stability.json and cases.md into the folder of --out. Ends with status 1
if anything is outside its stated tolerance.
"""

import argparse
import shlex
import sys
import time
from pathlib import Path

from dpc_jax.measure.stability.cases.names import DTYPES, SUBJECTS
from dpc_jax.measure.stability.report_parts import (
    PARTS,
    PartRequest,
    PartResult,
    check_names,
    run_part,
)
from dpc_jax.run.flags import FlagParser, Task, run_command

QUICK_DTYPES = ("float32",)
WRITES = ("stability.md", "stability.json", "cases.md", "stability_growth.png")
WRITES += ("stability_stiff_shape.png", "stability_stiff_other.png")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run the parts, write the report.

    Returns:
      The exit status: 0, 1 if anything is outside its tolerance or cannot be written, 2
      for a wrong flag, 130 after Ctrl-C.
    """
    return run_command(lambda: _read(arguments))


def _read(arguments):
    options = _parse(arguments)
    for flag, known in _list_known().items():
        check_names(flag, getattr(options, flag), known)
    return Task(
        lambda: _measure(options),
        out=options.out,
        interrupted=f"Interrupted; finished parts are in {options.out}.",
        writes=WRITES,
    )


def _measure(options):
    """Run the parts and print what failed; the exit status."""
    results, path = _run_parts(options)
    failures = [f for result in results.values() for f in result.failures]
    for failure in failures:
        print(f"Outside tolerance: {failure}")
    num_failed = len(failures)
    print(f"{num_failed} outside tolerance." if failures else "All within tolerance.")
    print(f"Report: {path}")
    return int(bool(failures))


def _list_known():
    return {"parts": tuple(PARTS), "subjects": tuple(SUBJECTS), "dtypes": DTYPES}


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("stability", description="What happens in extreme cases.")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/stability"), help="folder (%(default)s)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a small version of each part, in about two minutes; the cases in "
        f"{','.join(QUICK_DTYPES)} unless --dtypes says otherwise",
    )
    for flag, known in _list_known().items():
        words = f"some of {','.join(known)}; default: all"
        parser.add_argument(f"--{flag}", type=_split, help=words)
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers")
    return parser


def _parse(arguments):
    options = make_parser().parse_args(arguments)
    if options.quick and options.dtypes is None:
        options.dtypes = QUICK_DTYPES
    return options


def _split(text):
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _write_command(options):
    words = ["python", "-m", "dpc_jax.stability", f"--seed={options.seed}"]
    words += ["--quick"] * options.quick
    for flag, known in _list_known().items():
        words.append(f"--{flag}={','.join(getattr(options, flag) or known)}")
    return shlex.join(words)


def _run_parts(options):
    """Run part by part; the results and the path of the report."""
    # Heavy: flags are read first.
    from dpc_jax.learning.training.progress import ProgressReport
    from dpc_jax.measure.stability.report import write_report
    from dpc_jax.measure.timing import describe_machine

    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, PartResult] = {}
    seconds, path = {}, None
    about = {"seed": options.seed, "command": _write_command(options)}
    about["machine"] = describe_machine()
    # In the order of the report, whatever the order of the flag.
    parts = [part for part in PARTS if part in (options.parts or PARTS)]
    with ProgressReport("Stability", total=len(parts)) as progress:
        names = ("out", "quick", "seed", "subjects", "dtypes")
        wanted = {name: getattr(options, name) for name in names}
        request = PartRequest(**wanted, tell=progress.tell)
        for step, part in enumerate(parts, start=1):
            progress.tell(f"{step}/{len(parts)} {part}")
            start = time.perf_counter()
            results[part] = run_part(part, request)
            seconds[part] = time.perf_counter() - start
            # After each part, so that an interrupted run keeps those that are done.
            path = write_report(options.out, results, seconds=seconds, **about)
            progress.advance(step)
    return results, path


if __name__ == "__main__":
    sys.exit(main())
