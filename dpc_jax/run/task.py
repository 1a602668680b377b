"""The work of a command: an error in it is a sentence and an exit status."""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from dpc_jax.files import explaining_full_disk
from dpc_jax.outputs import explain, owning


def hush_jaxlib():
    """Keep jaxlib's own log off the terminal; to be called before jax is loaded.

    Version 0.10 prints a page of CPU features for each program that it reads from the
    cache. Errors of XLA come as exceptions, so that none is lost.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def say_missing(error: ModuleNotFoundError) -> int:
    """Say which library is not installed; the exit status. Our own modules are there.

    Raises:
      ModuleNotFoundError: for one of them.
    """
    if str(error.name).partition(".")[0] == "dpc_jax":
        raise error
    print(f"Error: {explain(error)}", file=sys.stderr)
    return 1


class Task(NamedTuple):
    """What a command does when its flags are read.

    Attributes:
      work: does it; returns the exit status, None for 0.
      out: folder that is written to.
      interrupted: what to say after Ctrl-C.
      writes: names of the work's files in it, see `owning`; none where the work claims
        its files itself.
      inputs: files that the work reads.
      errors: that are said in one sentence; others are defects of ours.
    """

    work: Callable[[], int | None]
    out: Path
    interrupted: str
    writes: Sequence[str] = ()
    inputs: Sequence[Path] = ()
    errors: tuple[type[Exception], ...] = (ValueError, OSError)


def run_command(read: Callable[[], Task]) -> int:
    """Read the flags of a command and do its task; its exit status.

    It is the task's own, 1 for an error in it, 2 for wrong flags, for which `read`
    raises ValueError, and 130 after Ctrl-C. With DPC_JAX_TRACEBACK in the environment
    errors of the task keep their traceback.
    """
    hush_jaxlib()
    try:
        task = read()
    except (ValueError, OSError) as error:
        print(f"Error: {explain(error)}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        return say_missing(error)
    try:
        with (
            explaining_full_disk(task.out),
            owning(task.out, task.writes, inputs=task.inputs),
        ):
            return task.work() or 0
    except task.errors as error:
        if os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {explain(error)}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        return say_missing(error)
    except KeyboardInterrupt:
        print(task.interrupted, file=sys.stderr)
        return 130
