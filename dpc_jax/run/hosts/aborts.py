"""The end of a job in a sentence, where jax's own client aborts the process.

When a process of a job is lost, or the coordinator, jax's C++ client ends every other
process by abort(), with a stack trace. Python hears of none of it. Here the signal of
abort() is caught in C, and what the client has printed is kept from the screen.
"""

import contextlib
import ctypes
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from typing import IO

_FATAL = "JAX distributed service detected fatal errors"
# What C++ prints of a job's ordinary life and of its end.
_NOISE = re.compile(
    r"gloo|connected to \d+ peer|coordination|distributed service|grpc", re.I
)
_SECONDS_TO_END = 5
_keeping = []  # so that the function that C calls lives on


@contextlib.contextmanager
def speaking_for_jax(explain: Callable[[str], str]) -> Iterator[Callable[[], None]]:
    """Have an abort of jax's client end the process by a sentence and exit status 1.

    Other aborts stay what they are.

    Args:
      explain: the sentence for the client's own words.

    Yields:
      What to call before this process lets the others end: it says itself why it
      ends, and an abort that meets it waits until it has said so.
    """
    with contextlib.ExitStack() as stack:
        kept, error = _keep_output_of_libraries(stack)

        ended = threading.Event()

        def end(_):
            if ended.is_set():
                time.sleep(_SECONDS_TO_END)
            text = _read(kept)
            if _FATAL in text:
                os.write(error, f"Error: {explain(text)}\n".encode())
                os._exit(1)
            os.write(error, text.encode())

        libc = ctypes.CDLL(None)
        handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(end)
        _keeping.append(handler)
        libc.signal(int(signal.SIGABRT), handler)
        try:
            yield ended.set
        finally:
            # abort() may come until the process has ended: the handler stays.
            ended.set()
            for line in _read(kept).splitlines():
                if not _NOISE.search(line):
                    print(line, file=sys.stderr)


def _keep_output_of_libraries(stack) -> tuple[IO[bytes], int]:
    """Send what C++ prints to a file; Python's own streams go where they went.

    Returns:
      The file, and the descriptor of the true stderr.
    """
    for name, number in (("stdout", 1), ("stderr", 2)):
        stream = getattr(sys, name)
        stream.flush()
        copy = open(
            os.dup(number),
            "w",
            buffering=1,
            encoding=stream.encoding,
            errors=stream.errors,
        )
        stack.callback(copy.flush)
        setattr(sys, name, copy)
    kept = tempfile.TemporaryFile()
    os.dup2(kept.fileno(), 1)
    os.dup2(kept.fileno(), 2)
    return kept, sys.stderr.fileno()


def _read(kept):
    size = os.fstat(kept.fileno()).st_size
    return os.pread(kept.fileno(), size, 0).decode("utf-8", errors="replace")
