"""The command dpc_jax: `dpc_jax fit ...` is `python -m dpc_jax.fit ...`.

Nothing heavy is loaded for --help or for a wrong flag.
"""

import importlib
import sys
from typing import NamedTuple


class Command(NamedTuple):
    """A command.

    Attributes:
      module: that it starts, as `python -m` does.
      text: what it does, for --help.
    """

    module: str
    text: str


COMMANDS = {
    "train": Command("dpc_jax.main", "train, evaluate, report; goes on where stopped"),
    "predict": Command("dpc_jax.predict", "images to 3D shapes, by a trained run"),
    "fit": Command("dpc_jax.fit", "images of one object to 3D, without training"),
    "data": Command("dpc_jax.data.__main__", "fetch data sets, show and check them"),
    "compare": Command("dpc_jax.compare", "runs side by side, as a page"),
    "paper": Command("dpc_jax.paper", "the paper's tables and figures"),
    "benchmark": Command("dpc_jax.benchmark", "error against run time"),
    "stability": Command("dpc_jax.stability", "what happens in extreme cases"),
}
_HELP = """usage: dpc_jax COMMAND [flags]

3D shape and camera pose from images alone.

{commands}

dpc_jax COMMAND --help lists the flags of one; python -m dpc_jax.COMMAND is the
same (of train: dpc_jax.main). A first run, in a few minutes:

  dpc_jax train --config=debug
"""


def describe() -> str:
    """The text of --help."""
    width = max(map(len, COMMANDS)) + 2
    lines = [f"  {name:{width}}{command.text}" for name, command in COMMANDS.items()]
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
    try:
        # Flags of a config are found in sys.argv, and a command's own name, too.
        sys.argv = [f"dpc_jax {name}", *rest]
        module = importlib.import_module(COMMANDS[name].module)
        return module.start() if name == "train" else module.main(rest)
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return 130
