"""The paper's experiments: python -m dpc_jax.paper --out=DIR --experiment=NAME

Trains what is missing and writes DIR/index.html, the paper's numbers beside ours. The
same command goes on where it was stopped.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.experiments.catalogue import CATEGORIES, NAMES
from dpc_jax.experiments.runs import SIZES, Request
from dpc_jax.task import FlagParser, Task, reading_names, run_command

# In --out; each run claims its own folder.
WRITES = ("index.html", "logs/", "figures/")


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("paper", description="The paper's tables and figures.")
    names, of_size = {"metavar": "NAMES", "default": ()}, "default: of the size"
    add = parser.add_argument
    add("--out", type=Path, default=Path("runs/paper"), help="folder (%(default)s)")
    text = f"all, or of {', '.join(NAMES)}, with commas between"
    add("--experiment", type=reading_names(("all", *NAMES)), **names, help=text)
    text = f"{', '.join(SIZES)} (%(default)s)"
    add("--size", default="cpu", choices=SIZES, metavar="SIZE", help=text)
    add("--category", type=reading_names(CATEGORIES), **names, help=of_size)
    add("--seeds", type=_read_seeds, default=(), metavar="N,N", help=of_size)
    text = "its folder of synsets, instead of procedural shapes"
    add("--shapenet", type=Path, metavar="DIR", help=text)
    text = "keeps rendered data sets"
    add("--data", type=Path, default=Path("data"), metavar="DIR", help=text)
    text = "the page of what is there alone"
    add("--no-training", action="store_true", help=text)
    return parser


def _read_seeds(text):
    words = [part.strip() for part in text.split(",")] if text else []
    if wrong := [word for word in words if not word.isdecimal()]:
        raise argparse.ArgumentTypeError(
            f"seeds must be whole numbers from 0 on, as in 0,1,2, not {wrong[0]!r}"
        )
    return tuple(sorted(set(map(int, words))))


def make_request(options: argparse.Namespace) -> Request:
    """What the flags ask for; ValueError where they do not fit together."""
    folder = options.shapenet
    if folder and not folder.is_dir():
        raise ValueError(
            f"--shapenet must be a folder that exists, but it is {folder}; give that "
            "of ShapeNet's synsets."
        )
    shapenet = str(folder.absolute()) if folder else ""
    is_all = not options.experiment or "all" in options.experiment
    names = NAMES if is_all else options.experiment
    request = Request(names, options.size, shapenet, options.category, options.seeds)
    made = {experiment.name for experiment in request.list_experiments()}
    missing = [name for name in names if name not in made]
    if missing and not is_all:
        raise ValueError(
            f"--category must fit --experiment={','.join(names)}, but {missing[0]} is "
            f"not made of {','.join(options.category)}; leave one of them out."
        )
    return request


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, write the page; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    request = make_request(options)
    from dpc_jax.experiments.training import run_suite  # heavy: flags come first

    def work():
        page, failed = run_suite(
            request, options.out, trains=not options.no_training, cache=options.data
        )
        print(f"Page: {page}")
        return int(bool(failed))

    return Task(
        work,
        out=options.out,
        interrupted=f"Interrupted; the page in {options.out} shows what is there, and "
        "the same command goes on.",
        writes=WRITES,
    )


if __name__ == "__main__":
    sys.exit(main())
