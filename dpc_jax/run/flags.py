"""Flags of commands: what is wrong with them is said in one sentence."""

import argparse
from typing import NoReturn


class FlagParser(argparse.ArgumentParser):
    """A parser that raises instead of printing the list of all flags."""

    def error(self, message: str) -> NoReturn:
        """See the class.

        Raises:
          ValueError: always.
        """
        raise ValueError(
            f"Expected flags as --help lists them, but {message}; correct the command."
        )
