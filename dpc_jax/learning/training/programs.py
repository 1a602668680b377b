"""The compiled training programs of a run's stages, made before they are needed.

Each stage is a program of its own that takes XLA many seconds. While one stage trains,
those of the next ones compile in a thread of low priority. The results are the same:
a program does not depend on where or when it was compiled.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotDone
from contextlib import AbstractContextManager
from typing import Any

import jax

from dpc_jax.learning.schedules import Span, Stage

THREADS = "compile"  # begins the names of the threads that compile
_NICENESS = 5  # of a program that nobody waits for, beyond that of training
_POLL_SECONDS = 0.2  # between two looks at whether the run shall stop

# (state, batch) -> (state, metrics); the old state's memory goes to the new one.
Program = Callable[[Any, Any], tuple[Any, dict]]


class StagePrograms:
    """The programs of a run's stages; use as a context manager.

    Args:
      make_step: gives the jitted step of a stage, a function (state, batch) ->
        (state, metrics) that donates the state and keeps its shardings.
      spans: of the run's stages.
      check: is given each compiled step, and may refuse it by an error.
    """

    def __init__(
        self,
        make_step: Callable[[Stage], Any],
        spans: Sequence[Span],
        *,
        check: Callable[[jax.stages.Compiled], None] = lambda _: None,
    ):
        self._make_step, self._spans, self._check = make_step, tuple(spans), check
        self._background = _start_thread(_lower_priority)
        self._pending: dict[Stage, Future] = {}
        self._stage: Stage | None = None
        self._program: Program | None = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """Give up what has not begun to compile, and wait for nothing."""
        self._background.shutdown(wait=False, cancel_futures=True)

    def find(self, step: int) -> Program | None:
        """The program of a step, where it is that of the step before."""
        return self._program if self._find_stage(step) == self._stage else None

    def begin(
        self,
        step: int,
        state: Any,
        batch: Any,
        *,
        should_stop: Callable[[], bool] = lambda: False,
        waiting: Callable[[], AbstractContextManager] = contextlib.nullcontext,
    ) -> Program | None:
        """Wait for the program of a stage's first step; those after it compile on.

        Args:
          step: the first one of a stage, or of a resumed run.
          state, batch: of that step; their shapes, dtypes and shardings are compiled.
          should_stop: asked while it waits.
          waiting: a context to wait in, unless the program is there already.

        Returns:
          The program; None where it was asked to stop.

        Raises:
          Exception: whatever made the compilation fail.
        """
        stage = self._find_stage(step)
        structs = jax.tree.map(_describe, (state, batch))
        own = self._pending.pop(stage, None)
        is_ready = own is not None and own.done()
        if own is None or own.cancel():  # not begun: nothing to wait behind
            front = _start_thread()
            own = front.submit(self._compile, stage, structs)
            front.shutdown(wait=False)
        for span in self._spans:
            if span.start > step and span.stage not in self._pending:
                later = self._background.submit(self._compile, span.stage, structs)
                self._pending[span.stage] = later
        with contextlib.nullcontext() if is_ready else waiting():
            while not should_stop():
                with contextlib.suppress(NotDone):
                    self._program = own.result(timeout=_POLL_SECONDS)
                    self._stage = stage
                    return self._program
        return None

    def run_ahead(self, function: Callable[[], Any]):
        """Have another function run in the background, after what waits there."""
        self._background.submit(function)

    def raise_failures(self):
        """Raise what made the compilation of a later stage fail, rather than there."""
        for pending in self._pending.values():
            if pending.done():
                pending.result()

    def _compile(self, stage, structs) -> Program:
        """Compile the program of a stage, or read it from the persistent cache."""
        program = self._make_step(stage).lower(*structs).compile()
        self._check(program)
        return program

    def _find_stage(self, step):
        return next(s.stage for s in self._spans if s.start <= step < s.end)


def _describe(leaf):
    """Shape, dtype and sharding; that of an array bound to no device is left open."""
    if not isinstance(leaf, jax.Array):
        return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)
    return jax.ShapeDtypeStruct(
        leaf.shape,
        leaf.dtype,
        sharding=leaf.sharding if leaf.committed else None,
        weak_type=leaf.weak_type,
    )


def _start_thread(initializer=None):
    """One thread. At its end Python waits for it, because XLA cannot be interrupted."""
    return ThreadPoolExecutor(1, thread_name_prefix=THREADS, initializer=initializer)


def _lower_priority():
    """Let training go first; on Linux each thread has a priority of its own."""
    with contextlib.suppress(OSError, AttributeError):
        thread = threading.get_native_id()
        own = os.getpriority(os.PRIO_PROCESS, thread)
        os.setpriority(os.PRIO_PROCESS, thread, own + _NICENESS)
