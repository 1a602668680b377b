"""Data sets from the command line.

python -m dpc_jax.data fetch chair         open meshes, from Debian packages
python -m dpc_jax.data show FOLDER         what is in a set, and a sheet of pictures
python -m dpc_jax.data check FOLDER        what is wrong with a set
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from dpc_jax import files, outputs
from dpc_jax.data.open import RECIPES
from dpc_jax.task import FlagParser, Task, read_count, run_command


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("data", takes="COMMAND", description="Get data and look at it.")
    commands = parser.add_subparsers(dest="command", required=True, prog=parser.prog)
    fetch = commands.add_parser("fetch", help="open meshes, from Debian packages")
    fetch.add_argument("category", choices=tuple(RECIPES), help="of the meshes")
    fetch.add_argument("--out", default="data/open", help="folder (%(default)s)")
    show = commands.add_parser("show", help="what is in a set, with a sheet of it")
    check = commands.add_parser("check", help="what is wrong with a set")
    for command, models in ((show, 8), (check, None)):
        add = command.add_argument
        add("folder", help="a rendered set, or of meshes or images")
        number = f"of meshes or images, how many ({models or 'all'})"
        add("--models", type=read_count, default=models, help=number)
    show.add_argument("--out", help="picture to write (runs/FOLDER-sheet.png)")
    return parser


# What reads meshes and draws is heavy: flags are read first.


def _read(flags) -> Task:
    out, work = Path("runs"), lambda: _look(flags)
    if flags.command == "fetch":
        out, work = Path(flags.out), lambda: _fetch(flags)
    errors = ValueError, RuntimeError, OSError
    return Task(work, out, "Stopped; the same command continues.", errors=errors)


def _fetch(flags):
    from dpc_jax.data.open import fetching

    fetching.fetch_category(flags.category, flags.out)


def _look(flags):
    """Check a set, or list and draw it; the status is 1 for errors."""
    from dpc_jax.data.look import checks, overview

    with overview.open_set(flags.folder, models=flags.models) as opened:
        lines = overview.describe_set(opened)
        if flags.command == "show":
            _say([*lines, _draw(opened, flags)])
            return 0
        findings = checks.check_set(opened.data, opened.lens)
        is_posed = checks.list_carvable(opened.data)
    poses = "poses fit their masks" if is_posed else "no poses compared"
    found = findings or [f"no fault found; {poses}"]
    _say([lines[0], *(f"  {text}" for text in found)])
    return int(any(text.startswith("error") for text in findings))


def _draw(opened, flags):
    """Write the sheet; a line that says what is on it."""
    from dpc_jax.data.look import overview

    # Among what commands make, not into a folder of data that may be anybody's.
    name = f"{Path(flags.folder).resolve().name}-sheet.png"
    out = Path(flags.out or Path("runs") / name)
    sheet, names = overview.draw_set(opened, flags.models)
    with outputs.owning(out.parent, [out.name]), files.replacing(out) as partial:
        sheet.save(partial, format="png")
    axes = "; red is the front, green the left, blue the top"
    if opened.data.quaternions is None:
        axes = ""
    return f"  {out} shows {', '.join(names)}{axes}"


def _say(lines):
    for line in lines:
        print(outputs.show_text(line))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; print a failure as a sentence."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
