"""The flags of commands: what is wrong with them is said in one sentence."""

import argparse
import functools
from collections.abc import Callable, Iterable
from typing import Any, NoReturn


class FlagParser(argparse.ArgumentParser):
    """A parser that raises instead of printing the list of all flags.

    Args:
      command: as the command `dpc_jax` names it, "fit" for instance.
      takes: what comes before the flags, for --help.
      settings: of `argparse.ArgumentParser`.
    """

    def __init__(self, command: str, *, takes: str = "", **settings: Any):
        program = f"dpc_jax {command}"
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
        """See the class.

        Raises:
          ValueError: always.
        """
        raise ValueError(
            f"Expected flags as --help lists them, but {message}; correct the command."
        )


def read_count(text: str) -> int:
    """A type of flag: a whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"it must be a whole number of at least 1, not {text!r}"
        )
    return int(text)


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
