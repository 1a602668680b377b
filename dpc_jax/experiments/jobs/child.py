"""How a run's process begins: -m dpc_jax.experiments.jobs.child PARENT CORE PROGRAM

Binds itself to a core and to its parent's life, then becomes the program: Python with
the rest of the arguments. It is a module of its own because Python code between fork
and exec is not safe in a process that has threads.
"""

import contextlib
import ctypes
import os
import signal
import sys

_SET_PARENT_DEATH_SIGNAL = 1  # in <linux/prctl.h>


def bind_to_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the parent dies, also by kill -9.

    A run then saves and stops. Where the system is not Linux nothing happens.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
        if os.getppid() != parent:  # it died before this was said
            sys.exit(0)


def bind_to_core(core: int) -> None:
    """Keep to one core, so that runs side by side do not wait for each other."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})


def main(arguments: list[str]) -> None:
    """Bind, then become the program; a core below 0 is none."""
    parent, core, *rest = arguments
    bind_to_parent(int(parent))
    if int(core) >= 0:
        bind_to_core(int(core))
    os.execv(sys.executable, [sys.executable, *rest])


if __name__ == "__main__":
    main(sys.argv[1:])
