"""The training loop: steps, log, validation, checkpoints, and a clean way out."""

import functools
import time
from collections.abc import Callable
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
from dpc_jax.learning.training.progress import Forecast, ProgressReport
from dpc_jax.learning.training.records import MetricLog, Stopwatch, Window
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
    evaluate: Callable[[TrainState], dict[str, float]] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    seconds: float = 0.0,
    title: str = "Training",
    may_stop_waiting: bool = True,
    validations_after: float = 0.0,
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
      should_stop: asked after each step, and while training waits for a program; True
        saves and returns.
      may_stop_waiting: False where it is asked after each step only, because several
        processes have to stop after the same one.
      seconds: training time spent before this call.
      title: of the progress bar.
      validations_after: how many validations what follows training takes as long as,
        for the time left.
      prepare: called in the background, once the programs of all stages are there: to
        compile what validation needs.
      check: is given the compiled step of each stage, and may refuse it by an error.

    Raises:
      NonFiniteError: at the first loss or gradient that is not finite, named with its
        step, and where the loss has grown far above that of the first step. Nothing is
        saved then: the last checkpoint is the last good state.
    """
    start, steps = int(state.step), config.train.steps
    watch = Stopwatch(seconds)
    window = Window(start, seconds, heads=config.pose.learned_heads)
    spans = schedules.list_spans(config.render, steps=steps)
    forecast = Forecast(
        steps,
        start=start,
        validate_every=config.log.evaluate if evaluate else None,
        validations_after=validations_after,
    )
    make_step = functools.partial(make_train_step, network, config)
    stops_waiting = should_stop if may_stop_waiting else lambda: False
    with (
        ProgressReport(title, total=steps, start=start) as progress,
        StagePrograms(make_step, spans, check=check) as programs,
    ):
        kept = log, checkpoints, evaluate, watch, window, forecast, progress
        books = _Books(config, *kept)
        for done in range(start + 1, steps + 1):
            batch = make_batch(dataset, done - 1, config)
            program = programs.find(done - 1) or _begin_stage(
                programs, (done - 1, state, batch), progress, window, stops_waiting
            )
            if program is None:  # asked to stop while it compiled
                books.record(done - 1)
                books.save(state)
                return Outcome(state, watch.seconds, False)
            if done == start + 1:
                programs.run_ahead(prepare)
            state, metrics = program(state, batch)
            window.add(metrics)
            progress.advance(done)
            stops = should_stop()
            books.settle(done, state, stops=stops)
            if stops and done < steps:
                return Outcome(state, watch.seconds, False)
            programs.raise_failures()
    return Outcome(state, watch.seconds, True)


class _Books(NamedTuple):
    """Log, validation and checkpoints of a run, after the steps where they are due."""

    config: Config
    log: MetricLog
    checkpoints: Checkpoints
    evaluate: Callable[[TrainState], dict[str, float]] | None
    watch: Stopwatch
    window: Window
    forecast: Forecast
    progress: ProgressReport

    def settle(self, done: int, state: TrainState, *, stops: bool):
        """What is due after `done` steps, the last of this call where it stops."""
        due, is_finished = self.config.log, done == self.config.train.steps
        is_last = stops or is_finished
        if is_last or _is_due(done, due.every):
            self.record(done)
        if self.evaluate and (is_finished or _is_due(done, due.evaluate)):
            self.window.check()
            self._validate(self.evaluate, done, state)
        if is_last or _is_due(done, due.checkpoint):
            self.window.check()
            self.save(state)

    def record(self, done: int):
        """Write the record of the steps since the last one, and show it."""
        if self.window.is_empty:
            return
        record = self.window.close(self.watch.seconds)
        self.log.write(record)
        self.forecast.add_rate(done, record["steps_per_second"])
        self.progress.report(
            done,
            loss=record["loss"],
            steps_per_second=record["steps_per_second"],
            seconds_left=self.forecast.compute_left(done),
        )

    def save(self, state: TrainState):
        """Save a checkpoint."""
        self.checkpoints.save(state, seconds=self.watch.seconds)

    def _validate(self, evaluate, done, state):
        seconds, started = self.watch.seconds, time.monotonic()
        with self.watch.paused():
            scores = evaluate(state)
        self.forecast.add_validation(time.monotonic() - started)
        self.log.write({"step": done, "seconds": round(seconds, 3)} | scores)
        found = describe_metrics(scores, share_digits=2)
        self.progress.tell(f"Validation at step {done}: {found}")


def _begin_stage(programs, step_state_batch, progress, window, should_stop):
    """The program of the stage that begins; None where asked to stop meanwhile."""
    if programs.is_ready(step_state_batch[0]):
        return programs.begin(*step_state_batch)
    with window.waiting(), progress.compiling():
        return programs.begin(*step_state_batch, should_stop=should_stop)


def _is_due(step: int, interval: int) -> bool:
    return interval > 0 and step % interval == 0
