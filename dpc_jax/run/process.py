"""Settings of the whole process, for long-running commands."""

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import jax

from dpc_jax.learning.devices import find_share
from dpc_jax.learning.training.programs import THREADS
from dpc_jax.render.devices import count_cores, read_settings, use_all_cores

_KEPT_DAYS = 30  # of a compiled program
# XLA tries to fuse all that comes before a normalisation into one kernel, in many
# tilings. Without this pass a training step compiles for a GPU in a third of the time.
_FAST_COMPILATION = "--xla_disable_hlo_passes=triton-softmax-rewriter"


def prepare_process(objects: int, devices: int = 0):
    """Set the process up for work on all cores, before jax is first used.

    CPU cores become devices of jax, unless it has begun, or XLA_FLAGS or its own
    setting say how many there are. Freed memory and compiled programs are kept, and
    programs for a GPU compile faster.

    Args:
      objects: of a batch, that the devices share.
      devices: how many; 0 for as many cores as divide the objects.
    """
    if not read_settings():
        with contextlib.suppress(RuntimeError):  # jax has begun
            use_all_cores(devices or find_share(objects, count_cores()))
    keep_freed_memory()
    hasten_compilation()
    keep_compiled_programs()


def hasten_compilation(driver: Path = Path("/dev/nvidiactl")) -> None:
    """Leave out a slow pass of XLA where there is an NVIDIA GPU; before jax begins.

    Flags that XLA_FLAGS has already stay, and win.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if driver.exists() and "--xla_disable_hlo_passes" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_FAST_COMPILATION}".lstrip()


def keep_freed_memory() -> None:
    """Have glibc keep what a step frees for the next one.

    By default blocks of some megabytes go back to the system and come again page by
    page, which takes a quarter of the CPU time of a step of configs/car.py. Threads of
    other devices than the first allocate from heaps of 64 MB, which glibc unmaps when
    they are empty, unless there is room to pad the one before. Without glibc nothing
    happens.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL("libc.so.6")
        trim_threshold, top_pad, mmap_max = -1, -2, -4  # names in malloc.h
        libc.mallopt(mmap_max, 0)
        libc.mallopt(trim_threshold, 2**31 - 1)
        libc.mallopt(top_pad, 64 * 2**20)


def keep_compiled_programs() -> None:
    """Have XLA's programs read from the user's cache folder instead of compiled again.

    A second start of a config, a resumed run and a second prediction then begin within
    seconds. JAX's own settings come first: JAX_COMPILATION_CACHE_DIR names another
    folder, JAX_ENABLE_COMPILATION_CACHE=false keeps nothing. Nor is anything kept where
    the folder cannot be written.
    """
    settings = jax.config.values
    is_named = settings["jax_compilation_cache_dir"] is not None
    if is_named or not settings["jax_enable_compilation_cache"]:
        return
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(home).expanduser() / "dpc_jax" / "programs"
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        return
    _drop_old_files(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # What compiles faster than this costs more to read than to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def _drop_old_files(folder):
    """Keep the programs of the last weeks: each change of a config makes others."""
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another command has dropped it
            if time.time() - path.stat().st_mtime > _KEPT_DAYS * 24 * 3600:
                path.unlink()


def leave(status: int) -> NoReturn:
    """End the process now, also while programs compile in the background.

    XLA cannot be interrupted: Python would wait for it to finish. What is written must
    be closed before.
    """
    compiling = [t for t in threading.enumerate() if t.name.startswith(THREADS)]
    for thread in compiling:
        thread.join(timeout=0.2)  # one that waits for work ends at once
    if any(thread.is_alive() for thread in compiling):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


@contextlib.contextmanager
def catch_signals() -> Iterator[threading.Event]:
    """An event that SIGTERM or Ctrl-C sets, so that a run saves before it ends.

    A second Ctrl-C interrupts at once.

    Raises:
      KeyboardInterrupt: at the end, where Ctrl-C asked for it.
    """
    asked, interrupted = threading.Event(), threading.Event()
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGTERM, signal.SIGINT)}

    def interrupt(*_):
        signal.signal(signal.SIGINT, signal.default_int_handler)
        interrupted.set()
        asked.set()

    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield asked
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
    if interrupted.is_set():
        raise KeyboardInterrupt
