"""The training loop: steps, log, validation, checkpoints, and a clean way out."""

from collections.abc import Callable
from typing import NamedTuple

from dpc_jax.config import Config
from dpc_jax.data import DataSet, choose_batch, read_batch
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.progress import ProgressReport
from dpc_jax.learning.records import MetricLog, Stopwatch, Window
from dpc_jax.learning.step import TrainState, make_train_step
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
      should_stop: asked after each step; True saves and returns.
      seconds: training time spent before this call.
      title: of the progress bar.

    Raises:
      NonFiniteError: at the first loss or gradient that is not finite, named with its
        step. Nothing is saved then: the last checkpoint is the last good state.
    """
    start, steps, due = int(state.step), config.train.steps, config.log
    watch = Stopwatch(seconds)
    window = Window(start, seconds, heads=config.pose.heads)
    train_step = _StagedStep(network, config)
    with ProgressReport(title, total=steps, start=start) as progress:
        for done in range(start + 1, steps + 1):
            batch = _make_batch(dataset, done - 1, config)
            state, metrics = train_step(state, batch, done - 1)
            window.add(metrics)
            progress.advance(done)
            stops, is_finished = should_stop(), done == steps
            is_last = stops or is_finished
            if _is_due(done, due.every) or is_last:
                record = window.close(watch.seconds)
                log.write(record)
                progress.report(
                    done,
                    loss=record["loss"],
                    steps_per_second=record["steps_per_second"],
                )
            if evaluate and (_is_due(done, due.evaluate) or is_finished):
                window.check()
                elapsed = round(watch.seconds, 3)
                with watch.paused():
                    scores = evaluate(state)
                log.write({"step": done, "seconds": elapsed, **scores})
                found = describe_metrics(scores, share_digits=2)
                progress.tell(f"Validation at step {done}: {found}")
            if _is_due(done, due.checkpoint) or is_last:
                window.check()
                checkpoints.save(state, seconds=watch.seconds)
            if stops and not is_finished:
                return Outcome(state, watch.seconds, False)
    return Outcome(state, watch.seconds, True)


class _StagedStep:
    """The training step of the stage at hand, compiled anew when the stage changes."""

    def __init__(self, network, config):
        self._network, self._config = network, config
        self._stage, self._step = None, None

    def __call__(self, state, batch, step):
        config = self._config
        stage = schedules.find_stage(step, config.render, steps=config.train.steps)
        if self._step is None or stage != self._stage:
            self._stage = stage
            self._step = make_train_step(self._network, config, stage)
        return self._step(state, batch)


def _make_batch(dataset, step, config):
    counts = dataset.counts
    models, views = choose_batch(
        len(counts),
        counts,
        seed=config.seed,
        step=step,
        models_per_batch=config.train.models_per_batch,
        views_per_batch=config.train.views_per_batch,
    )
    own = devices.find_own(len(models))
    return devices.assemble(read_batch(dataset, models[own], views[own]), config)


def _is_due(step: int, interval: int) -> bool:
    return interval > 0 and step % interval == 0
