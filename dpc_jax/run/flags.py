"""The flags of commands: what is wrong with them is said in one sentence."""

import argparse
import functools
import os
import sys
from collections.abc import Callable, Iterable
from typing import Any, NoReturn


def name_program(command: str) -> str:
    """How a command was started: "dpc_jax fit", or "python -m dpc_jax.fit"."""
    if sys.argv[0] == f"dpc_jax {command}":
        return sys.argv[0]
    return f"python -m dpc_jax.{'main' if command == 'train' else command}"


class FlagParser(argparse.ArgumentParser):
    """A parser that raises instead of printing the list of all flags.

    Args:
      command: as the command `dpc_jax` names it, "fit" for instance.
      takes: what comes before the flags, for --help.
      settings: of `argparse.ArgumentParser`.
    """

    def __init__(self, command: str, *, takes: str = "", **settings: Any):
        program = name_program(command)
        super().__init__(
            prog=program,
            usage=" ".join(filter(None, (program, takes, "[flags]"))),
            # Short, so that all flags are seen at once in a window of 24 lines.
            formatter_class=functools.partial(
                argparse.HelpFormatter, max_help_position=26
            ),
            **settings,
        )

    def error(self, message: str) -> NoReturn:
        """See the class. A file whose name begins with - looks like a flag.

        Raises:
          ValueError: always.
        """
        cure = "correct the command"
        words = [word for word in message.split() + sys.argv if word]
        if named := [w for w in words if w[0] == "-" and os.path.lexists(w)]:
            cure = f"write ./{named[0]} for the file whose name begins with -"
        raise ValueError(f"Expected flags as --help lists them, but {message}; {cure}.")


def reading_names(known: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    """A type of flag: some of the known names, with commas between."""
    known = tuple(known)

    def read(text):
        found = tuple(part.strip() for part in text.split(","))
        if unknown := [name for name in found if name not in known]:
            raise argparse.ArgumentTypeError(
                f"names must be of {', '.join(known)}, not {unknown[0] or 'empty'}"
            )
        return found

    return read
