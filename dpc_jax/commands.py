"""The command dpc_jax: `dpc_jax fit ...` is `python -m dpc_jax.fit ...`.

Nothing heavy is loaded for --help or for a wrong flag.
"""

import importlib
import sys
from types import ModuleType

# What each does, for --help.
COMMANDS = {
    "train": "train, evaluate, report; goes on where stopped",
    "predict": "images to 3D shapes, by a trained run",
    "fit": "images of one object to 3D, without training",
    "data": "fetch data sets, show and check them",
    "view": "shapes and a run in a browser, live",
    "compare": "runs side by side, as a page",
    "paper": "the paper's tables and figures",
    "benchmark": "error against run time",
    "stability": "what happens in extreme cases",
}
_HELP = """usage: dpc_jax COMMAND [flags]

3D shape and camera pose from images alone.

{commands}

dpc_jax COMMAND --help lists the flags of one; python -m dpc_jax.COMMAND is the
same (of train: dpc_jax.main). A first run, in a few minutes:

  dpc_jax train --config=debug
"""


def load_module(name: str) -> ModuleType:
    """The module of a command, which `python -m` starts."""
    others = {"train": "main", "data": "data.__main__"}
    return importlib.import_module(f"dpc_jax.{others.get(name, name)}")


def describe() -> str:
    """The text of --help."""
    width = max(map(len, COMMANDS)) + 2
    lines = [f"  {name:{width}}{text}" for name, text in COMMANDS.items()]
    return _HELP.format(commands="\n".join(lines))


def main(arguments: list[str] | None = None) -> int:
    """Start the command that is named first; returns its exit status."""
    words = sys.argv[1:] if arguments is None else arguments
    if not words or words[0] in ("--help", "-h", "help"):
        print(describe(), end="")
        return 0
    name, *rest = words
    if name == "--version":
        print(importlib.import_module("importlib.metadata").version("dpc_jax"))
        return 0
    if name not in COMMANDS:
        print(
            f"Error: Expected one of {', '.join(COMMANDS)}, but {name} was given; "
            "write for example dpc_jax train --config=car.",
            file=sys.stderr,
        )
        return 2
    return load_module(name).main(rest)
