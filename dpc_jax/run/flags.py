"""Commands: what is wrong is said in one sentence, and becomes an exit status."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from dpc_jax.files import explaining_full_disk


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


def run_command(work: Callable[[], object], *, out: Path, interrupted: str) -> int:
    """Do the work of a command; its exit status: 0, 1 for an error, 130 after Ctrl-C.

    With DPC_JAX_TRACEBACK in the environment errors keep their traceback.

    Args:
      out: folder that is written to. interrupted: what to say after Ctrl-C.
    """
    try:
        with explaining_full_disk(out):
            work()
    except (ValueError, OSError) as error:
        if os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)
        return 130
    return 0
