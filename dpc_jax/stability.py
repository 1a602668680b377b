"""Stiff and extreme cases: python -m dpc_jax.stability [--parts=...] [--out=DIR]

Compares every public function with an oracle where it may break, and writes
stability.md, stability.json and cases.md into DIR. Ends with status 1 where anything is
outside its stated tolerance.
"""

import argparse
import shlex
import sys
import time
from pathlib import Path

from dpc_jax.learning.progress import ProgressReport
from dpc_jax.measure.stability.cases.case import DTYPES
from dpc_jax.measure.stability.cases.catalogue import SUBJECTS, check_names
from dpc_jax.measure.stability.report import write_report
from dpc_jax.measure.stability.report_parts import PARTS, Order, PartResult, run_part
from dpc_jax.measure.timing import describe_machine


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run the parts, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/stability"))
    for name, known in (("parts", PARTS), ("subjects", SUBJECTS), ("dtypes", DTYPES)):
        parser.add_argument(
            f"--{name}",
            type=_split,
            default=tuple(known),
            help=f"some of {','.join(known)}; default: all",
        )
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    options = parser.parse_args(arguments)
    words = ["python", "-m", "dpc_jax.stability", f"--seed={options.seed}"]
    for name in ("parts", "subjects", "dtypes"):
        words.append(f"--{name}={','.join(getattr(options, name))}")
    results: dict[str, PartResult] = {}
    try:
        check_names("parts", options.parts, tuple(PARTS))
        check_names("subjects", options.subjects, tuple(SUBJECTS))
        check_names("dtypes", options.dtypes, DTYPES)
        path = _run_parts(options, shlex.join(words), results)
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        done = ", ".join(results) or "none"
        print(f"Interrupted; parts in {options.out}: {done}.", file=sys.stderr)
        return 130
    failures = [f for result in results.values() for f in result.failures]
    for failure in failures:
        print(f"Outside tolerance: {failure}")
    passes = all(result.passes for result in results.values())
    print("All within tolerance." if passes else f"{len(failures)} outside tolerance.")
    print(f"Report: {path}")
    return 0 if passes else 1


def _split(text):
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _run_parts(options, command, results):
    """Fill `results` part by part; the report holds those that are whole."""
    options.out.mkdir(parents=True, exist_ok=True)
    machine, seconds = describe_machine(), {}
    # In the order of the report, whatever that of the flag.
    parts = [part for part in PARTS if part in options.parts]
    with ProgressReport("Stability", total=len(parts)) as progress:
        order = Order(
            out=options.out,
            seed=options.seed,
            tell=progress.tell,
            subjects=options.subjects,
            dtypes=options.dtypes,
        )
        for step, part in enumerate(parts, start=1):
            progress.tell(f"{step}/{len(parts)} {part}")
            start = time.perf_counter()
            results[part] = run_part(part, order)
            seconds[part] = time.perf_counter() - start
            # After each part: those that are done took minutes.
            path = write_report(
                options.out,
                results,
                machine=machine,
                seconds=seconds,
                seed=options.seed,
                command=command,
            )
            progress.advance(step)
    return path


if __name__ == "__main__":
    sys.exit(main())
