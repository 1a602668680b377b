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
    start, steps, due = int(state.step), config.train.steps, config.log
    watch = Stopwatch(seconds)
    window = Window(start, seconds, heads=config.pose.learned_heads)
    spans = schedules.list_spans(config.render, steps=steps)
    forecast = Forecast(
        steps,
        start=start,
        validate_every=due.evaluate if evaluate else None,
        validations_after=validations_after,
    )
    make_step = functools.partial(make_train_step, network, config)
    stops_waiting = should_stop if may_stop_waiting else lambda: False
    with (
        ProgressReport(title, total=steps, start=start) as progress,
        StagePrograms(make_step, spans, check=check) as programs,
    ):
        log_steps = functools.partial(_log_steps, log, forecast, progress)
        for done in range(start + 1, steps + 1):
            batch = make_batch(dataset, done - 1, config)
            program = programs.find(done - 1) or _begin_stage(
                programs, (done - 1, state, batch), progress, window, stops_waiting
            )
            if program is None:  # asked to stop while it compiled
                if not window.is_empty:
                    log_steps(done - 1, window.close(watch.seconds))
                checkpoints.save(state, seconds=watch.seconds)
                return Outcome(state, watch.seconds, False)
            if done == start + 1:
                programs.run_ahead(prepare)
            state, metrics = program(state, batch)
            window.add(metrics)
            progress.advance(done)
            stops, is_finished = should_stop(), done == steps
            is_last = stops or is_finished
            if _is_due(done, due.every) or is_last:
                log_steps(done, window.close(watch.seconds))
            if evaluate and (_is_due(done, due.evaluate) or is_finished):
                window.check()
                _validate(evaluate, state, watch, forecast, log, progress)
            if _is_due(done, due.checkpoint) or is_last:
                window.check()
                checkpoints.save(state, seconds=watch.seconds)
            if stops and not is_finished:
                return Outcome(state, watch.seconds, False)
            programs.raise_failures()
    return Outcome(state, watch.seconds, True)


def _begin_stage(programs, step_state_batch, progress, window, should_stop):
    """The program of the stage that begins; None where asked to stop meanwhile."""
    if programs.is_ready(step_state_batch[0]):
        return programs.begin(*step_state_batch)
    with window.waiting(), progress.compiling():
        return programs.begin(*step_state_batch, should_stop=should_stop)


def _validate(evaluate, state, watch, forecast, log, progress):
    """Write and show the scores of a validation."""
    step, seconds, started = int(state.step), watch.seconds, time.monotonic()
    with watch.paused():
        scores = evaluate(state)
    forecast.add_validation(time.monotonic() - started)
    log.write({"step": step, "seconds": round(seconds, 3)} | scores)
    found = describe_metrics(scores, share_digits=2)
    progress.tell(f"Validation at step {step}: {found}")


def _log_steps(log, forecast, progress, done, record):
    """Write a record, and show it with the time left."""
    log.write(record)
    forecast.add_rate(done, record["steps_per_second"])
    progress.report(
        done,
        loss=record["loss"],
        steps_per_second=record["steps_per_second"],
        seconds_left=forecast.compute_left(done),
    )


def _is_due(step: int, interval: int) -> bool:
    return interval > 0 and step % interval == 0
