"""Shapes and a run in a browser: python -m dpc_jax.view WORKDIR|FILE...

Serves a page on this machine alone: clouds, surfaces, the cameras of the views, the
candidates of a view with their losses. A run may still be training: the page follows
its checkpoints. An image that is given to the page is predicted. Ctrl-C ends it.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.task import FlagParser, Task, run_command


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        "view",
        takes="WORKDIR|FOLDER|FILE...",
        description="Shapes of a run, of predictions or of files, in a browser.",
    )
    add = parser.add_argument
    text = "a run, results of predict or fit, or PLY, GLB and OBJ files"
    add("paths", nargs="+", type=Path, metavar="PATH", help=text)
    text = "of the page on this machine, the next free one (%(default)s)"
    add("--port", type=int, default=8080, metavar="N", help=text)
    text = "of rendered data of a run (as trained)"
    add("--data", type=Path, metavar="DIR", help=text)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and serve the page; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    from dpc_jax.run.viewing.page import serve  # loads what is heavy

    return Task(
        lambda: serve(options.paths, port=options.port, data=options.data),
        out=Path("."),
        interrupted="The page is closed.",
    )


if __name__ == "__main__":
    sys.exit(main())
