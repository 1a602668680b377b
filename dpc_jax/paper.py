"""The paper's experiments: python -m dpc_jax.paper --out=DIR --experiment=NAME

Trains what is missing and writes DIR/index.html and DIR/paper.md, the paper's numbers
beside ours. The same command goes on where it was stopped.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.experiments.catalogue import NAMES, find_experiments
from dpc_jax.experiments.published import CATEGORIES, TITLE
from dpc_jax.experiments.runs import Request, Source, choose_runs
from dpc_jax.experiments.sizes import SIZES
from dpc_jax.files import read_text
from dpc_jax.run.flags import FlagParser, Task, run_command

WRITES = ("index.html", "paper.md", "requests.json", "runs/", "logs/")
WRITES = (*WRITES, "figures/", "analyses/")
SOURCES = ("procedural", "open", "shapenet", "renders")


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser("paper", description="The paper's tables and figures.")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/paper"), help="folder (%(default)s)"
    )
    parser.add_argument(
        "--experiment",
        default="all",
        metavar="NAMES",
        help=f"all, or of {', '.join(NAMES)}, with commas between",
    )
    parser.add_argument(
        "--size",
        default="cpu",
        choices=SIZES,
        metavar="SIZE",
        help=f"{', '.join(SIZES)} (%(default)s)",
    )
    parser.add_argument(
        "--category", default="", metavar="NAMES", help="default: of the size"
    )
    parser.add_argument(
        "--seeds", default="", metavar="N,N", help="default: of the size"
    )
    parser.add_argument(
        "--source",
        default="procedural",
        choices=SOURCES,
        metavar="KIND",
        help=f"{', '.join(SOURCES)} (%(default)s)",
    )
    parser.add_argument(
        "--folder",
        default="",
        metavar="DIR",
        help="of the source: meshes, ShapeNet or renders",
    )
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        default=Path("data"),
        help="keeps rendered data sets",
    )
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="Markdown to write too"
    )
    parser.add_argument(
        "--only",
        default="*",
        metavar="RUNS",
        help="train only these; * stands for anything",
    )
    parser.add_argument(
        "--at-once",
        type=int,
        metavar="N",
        default=0,
        help="runs; default: as many as cores and memory allow",
    )
    parser.add_argument(
        "--no-training", action="store_true", help="the page of what is there alone"
    )
    return parser


def make_request(options: argparse.Namespace) -> Request:
    """What the flags ask for.

    Raises:
      ValueError: for flags that do not fit together.
    """
    categories = _split(options.category)
    if unknown := [name for name in categories if name not in CATEGORIES]:
        raise ValueError(
            f"--category must be of {', '.join(CATEGORIES)}, but it has "
            f"{unknown[0] or 'an empty name'}; write for example --category=car,chair."
        )
    seeds = _split(options.seeds)
    if wrong := [word for word in seeds if not word.isdecimal()]:
        raise ValueError(
            "--seeds must be whole numbers from 0 on, but it has "
            f"{wrong[0] or 'an empty one'}; write for example --seeds=0,1,2."
        )
    request = Request(
        options.experiment,
        options.size,
        make_source(options.source, options.folder),
        tuple(categories),
        tuple(sorted(set(map(int, seeds)))),
    )
    made = request.list_experiments()
    missing = [e for e in find_experiments(options.experiment) if e not in made]
    if missing and options.experiment != "all":
        raise ValueError(
            f"--category must fit --experiment={options.experiment}, but "
            f"{missing[0].name} is not made of {options.category}; leave one of them "
            "out."
        )
    if options.at_once < 0:
        raise ValueError(
            f"--at-once must be at least 1, but it is {options.at_once}; leave it out "
            "for as many as there are cores."
        )
    check_page(options.page)
    return request


def check_page(page: Path | None) -> None:
    """Refuse a Markdown file that could not be written when all runs have ended.

    Raises:
      ValueError: for a folder, a place in what is no folder, or another page.
    """
    if page is None:
        return
    above = next(p for p in page.absolute().parents if p.exists())
    if page.is_dir() or not above.is_dir():
        wrong = f"{page} is a folder" if page.is_dir() else f"{above} is no folder"
        raise ValueError(
            f"--page must be a file to write, but {wrong}; write for example "
            "--page=docs/paper.md."
        )
    if page.exists() and not read_text(page).startswith(f"# {TITLE}\n"):
        raise ValueError(
            f"--page must be a new file or a page of this command, but {page} does not "
            f"begin with # {TITLE}; move it, or give another --page."
        )


def make_source(kind: str, folder: str) -> Source:
    """The source of objects.

    Raises:
      ValueError: where its folder is missing, or given without need.
    """
    if kind == "procedural":
        if folder:
            raise ValueError(
                "--folder must be left out for procedural shapes, but it is "
                f"{folder}; give --source=open, shapenet or renders with it."
            )
        return Source()
    if not Path(folder).is_dir() or not folder:
        raise ValueError(
            f"--folder must be a folder that exists for --source={kind}, but it is "
            f"{folder or 'not given'}; write for example --folder=data/{kind}."
        )
    return Source(kind, str(Path(folder).absolute()))


def _split(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")] if text else []


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, write the page; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    request = make_request(options)
    runs = choose_runs(request, _split(options.only) or [""])
    from dpc_jax.experiments.suite import Place, run_suite  # heavy: flags come first

    place = Place(options.out, options.data, options.page)

    def work():
        page, failed = run_suite(
            request,
            place,
            [] if options.no_training else runs,
            at_once=options.at_once,
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
