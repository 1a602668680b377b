"""The training loop: steps, log, validation, checkpoints, and a clean way out."""

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.learning import schedules
from dpc_jax.learning.batches import make_batch
from dpc_jax.learning.step import TrainState, make_train_step
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.learning.training.programs import StagePrograms
from dpc_jax.learning.training.records import MetricLog, Window
from dpc_jax.networks import ShapePoseNetwork


class Outcome(NamedTuple):
    """How a call of `train` ended.

    Attributes:
      state: the last state.
      seconds: training time so far, over all calls; validation does not count.
      is_finished: False where it was asked to stop before the last step.
    """

    state: TrainState
    seconds: float
    is_finished: bool


def train(
    state: TrainState,
    dataset: DataSet,
    *,
    network: ShapePoseNetwork,
    config: Config,
    checkpoints: Checkpoints,
    log: MetricLog,
    evaluate: Callable[[TrainState], dict[str, float]],
    should_stop: Callable[[], bool] = lambda: False,
    seconds: float = 0.0,
    title: str = "Training",
    prepare: Callable[[], object] = lambda: None,
    check: Callable[[jax.stages.Compiled], None] = lambda _: None,
) -> Outcome:
    """Train from a state to the last step of the config.

    A batch is a function of seed and step alone, so a run that stops and goes on sees
    what a run without a break sees.

    Args:
      state: the first state; its buffers are donated.
      dataset: training views.
      network, config: what is learned, and how; `config.log` says how often log,
        validation and checkpoints are due. The last step has all three.
      checkpoints, log: where they are written.
      evaluate: gives the validation metrics of a state.
      should_stop: asked after each step, and while a single process waits for a
        program; True saves and returns.
      seconds: training time spent before this call.
      title: of the lines that say how far training is.
      prepare: called in the background, once the programs of all stages are there: to
        compile what validation needs.
      check: is given the compiled step of each stage, and may refuse it by an error.

    Raises:
      NonFiniteError: at the first loss or gradient that is not finite, named with its
        step, and where the loss has grown far above that of the first step. Nothing is
        saved then: the last checkpoint is the last good state.
    """
    start, steps = int(state.step), config.train.steps
    window = Window(start, seconds, heads=config.pose.learned_heads)
    books = _Books(config, title, log, checkpoints, evaluate, window)
    spans = schedules.list_spans(config.render, steps=steps)
    make_step = functools.partial(make_train_step, network, config)
    # Several processes have to stop after the same step.
    stops_waiting = should_stop if jax.process_count() == 1 else lambda: False
    how = {"should_stop": stops_waiting, "waiting": books.compiling}
    with StagePrograms(make_step, spans, check=check) as programs:
        for done in range(start + 1, steps + 1):
            batch = make_batch(dataset, done - 1, config)
            program = programs.find(done - 1)
            program = program or programs.begin(done - 1, state, batch, **how)
            if program is None:  # asked to stop while it compiled
                books.record(done - 1)
                books.save(state)
                return Outcome(state, window.seconds, False)
            if done == start + 1:
                programs.run_ahead(prepare)
            state, metrics = program(state, batch)
            window.add(metrics)
            stops = should_stop()
            books.settle(done, state, stops=stops)
            if stops and done < steps:
                return Outcome(state, window.seconds, False)
            programs.raise_failures()
    return Outcome(state, window.seconds, True)


class _Books(NamedTuple):
    """Log, validation and checkpoints of a run, after the steps where they are due."""

    config: Config
    title: str
    log: MetricLog
    checkpoints: Checkpoints
    evaluate: Callable[[TrainState], dict[str, float]]
    window: Window

    def settle(self, done: int, state: TrainState, *, stops: bool):
        """What is due after `done` steps, the last of this call where it stops."""
        due, is_finished = self.config.log, done == self.config.train.steps
        is_last = stops or is_finished
        if is_last or _is_due(done, due.every):
            self.record(done)
        # One soon before the last would tell the same.
        is_early = 2 * (self.config.train.steps - done) >= due.evaluate
        if is_finished or (_is_due(done, due.evaluate) and is_early):
            self.window.check()
            self._validate(done, state)
        if is_last or _is_due(done, due.checkpoint):
            self.window.check()
            self.save(state)

    def record(self, done: int):
        """Write the record of the steps since the last one, and show it."""
        if self.window.is_empty:
            return
        record, steps = self.window.close(), self.config.train.steps
        self.log.write(record)
        loss, rate = record["loss"], record["steps_per_second"]
        left = (steps - done) / max(rate, 1e-3)  # it is rounded to thousandths
        found = f"loss {loss:.2f}, {rate:.1f} steps/s, {left:.0f} s of training left"
        print(f"{self.title}: step {done}/{steps}, {found}", flush=True)

    def save(self, state: TrainState):
        """Save a checkpoint."""
        self.checkpoints.save(state, seconds=self.window.seconds)

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """Say that a program compiles, and how long; no step takes that time."""
        started = time.monotonic()
        print(f"{self.title}: compiling", flush=True)
        yield
        seconds = time.monotonic() - started
        self.window.add_waiting(seconds)
        print(f"{self.title}: compiling took {seconds:.1f} s", flush=True)

    def _validate(self, done, state):
        seconds = self.window.seconds
        scores = self.evaluate(state)
        self.window.set_clock(seconds)
        self.log.write({"step": done, "seconds": round(seconds, 3)} | scores)
        found = describe_metrics(scores, share_digits=2)
        print(f"Validation at step {done}: {found}", flush=True)


def _is_due(step: int, interval: int) -> bool:
    return interval > 0 and step % interval == 0
