"""A command's flags and its work: an error in them is a sentence and an exit status."""

import argparse
import functools
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from dpc_jax.files import explaining_full_disk
from dpc_jax.outputs import explain, owning


class FlagParser(argparse.ArgumentParser):
    """A parser that raises instead of printing the list of all flags.

    Args:
      command: as the command `dpc_jax` names it, "fit" for instance; "" where the
        settings have its name as `prog`.
      takes: what comes before the flags, for --help.
    """

    def __init__(self, command: str = "", *, takes: str = "", **settings: Any):
        program = settings.setdefault("prog", f"dpc_jax {command}")
        super().__init__(
            usage=" ".join(filter(None, (program, takes, "[flags]"))),
            # Short, so that all flags are seen at once in a window of 24 lines.
            formatter_class=functools.partial(
                argparse.HelpFormatter, max_help_position=26
            ),
            **settings,
        )

    def error(self, message: str) -> NoReturn:
        """Raise ValueError."""
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


class Task(NamedTuple):
    """What a command does when its flags are read."""

    work: Callable[[], int | None]  # returns the exit status, None for 0
    out: Path  # folder that is written to
    interrupted: str  # what to say after Ctrl-C
    # Of the work's files in the folder, see `owning`; none where it claims them itself.
    writes: Sequence[str] = ()
    inputs: Sequence[Path] = ()  # that the work reads
    # That are said in one sentence; others are defects of ours.
    errors: tuple[type[Exception], ...] = (ValueError, OSError)


def run_command(read: Callable[[], Task]) -> int:
    """Read the flags of a command and do its task; its exit status.

    It is the task's own, 1 for an error in it or a library that is not installed, 2 for
    wrong flags, for which `read` raises ValueError, and 130 after Ctrl-C. With
    DPC_JAX_TRACEBACK in the environment errors of the task keep their traceback.
    """
    # Before jax is loaded: jaxlib 0.10 prints a page of CPU features for each program
    # that it reads from the cache. Errors of XLA come as exceptions: none is lost.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    task: Task | None = None
    errors: tuple[type[Exception], ...] = (ValueError, OSError)
    try:
        task = read()
        errors = task.errors
        with (
            explaining_full_disk(task.out),
            owning(task.out, task.writes, inputs=task.inputs),
        ):
            return task.work() or 0
    except KeyboardInterrupt:
        print(task.interrupted if task else "Interrupted.", file=sys.stderr)
        return 130
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] == "dpc_jax":
            raise  # our own modules are there
        print(f"Error: {explain(error)}", file=sys.stderr)
        return 1
    except errors as error:
        if task and os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {explain(error)}", file=sys.stderr)
        return 1 if task else 2
