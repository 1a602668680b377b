"""The training loop: steps, log, validation, checkpoints, and a clean way out."""

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.config.settings import Settings
from dpc_jax.data import DataSet, choose_batch, read_batch
from dpc_jax.learning import schedules
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.log import MetricLog
from dpc_jax.learning.progress import ProgressReport
from dpc_jax.learning.step import TrainState, make_train_step
from dpc_jax.networks import ShapePoseNetwork


class NonFiniteError(RuntimeError):
    """Training met a loss or gradient that is not finite."""


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


class Intervals(NamedTuple):
    """Steps between log lines, validations and checkpoints; 0 is never."""

    log: int
    evaluate: int
    checkpoint: int


def train(
    state: TrainState,
    dataset: DataSet,
    *,
    network: ShapePoseNetwork,
    settings: Settings,
    intervals: Intervals,
    checkpoints: Checkpoints,
    log: MetricLog,
    evaluate: Callable[[TrainState], dict[str, float]] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    seconds: float = 0.0,
    title: str = "Training",
) -> Outcome:
    """Train from a state to the last step of the settings.

    A batch is a function of seed and step alone, so a run that stops and goes on sees
    what a run without a break sees.

    Args:
      state: the first state; its memory is given up.
      dataset: training views.
      network, settings: what is learned.
      intervals: of log, validation and checkpoints, in steps. The last step has all
        three.
      checkpoints, log: where they are written.
      evaluate: gives the validation metrics of a state.
      should_stop: asked after each step; True saves and returns.
      seconds: training time spent before this call.
      title: of the progress bar.

    Raises:
      NonFiniteError: at the first loss or gradient that is not finite, named with its
        step. Nothing is saved then: the last checkpoint is the last good state.
    """
    start = int(state.step)
    counts = dataset.counts
    train_step, stage = None, None
    window: list[dict] = []
    window_start, window_seconds = start, seconds
    clock = time.monotonic()

    def spend():
        """Seconds of training until now."""
        return seconds + time.monotonic() - clock

    with ProgressReport(title, total=settings.steps, start=start) as progress:
        for step in range(start, settings.steps):
            if stage != (current := schedules.find_stage(step, settings)):
                stage = current
                train_step = make_train_step(network, settings, stage)
            chosen = choose_batch(
                len(counts),
                counts,
                seed=settings.seed,
                step=step,
                models_per_batch=settings.models_per_batch,
                views_per_batch=settings.views_per_batch,
            )
            state, metrics = train_step(state, read_batch(dataset, *chosen))
            window.append(metrics)
            # The step before has finished while this one runs: reading it is free.
            if len(window) > 1:
                check_finite(window[-2], step - 1)
            done = step + 1
            progress.advance(done)
            stops = should_stop()
            is_last = done == settings.steps or stops

            if _is_due(done, intervals.log) or is_last:
                check_finite(window[-1], step)
                record = summarize(window, settings)
                elapsed = spend()
                rate = (done - window_start) / max(elapsed - window_seconds, 1e-9)
                log.write(
                    {"step": done, "seconds": round(elapsed, 3), **record}
                    | {"steps_per_second": round(rate, 3)}
                )
                progress.report(done, loss=record["loss"], steps_per_second=rate)
                window = []
                window_start, window_seconds = done, elapsed

            pause = time.monotonic()
            elapsed = spend()  # the validation itself is not training
            is_finished = done == settings.steps
            if evaluate and (_is_due(done, intervals.evaluate) or is_finished):
                if window:
                    check_finite(window[-1], step)
                scores = evaluate(state)
                log.write({"step": done, "seconds": round(elapsed, 3), **scores})
                progress.tell(_describe(done, scores))
            clock += time.monotonic() - pause
            if _is_due(done, intervals.checkpoint) or is_last:
                if window:
                    check_finite(window[-1], step)
                checkpoints.save(state, seconds=spend())
            if stops and not is_finished:
                return Outcome(state, spend(), False)
    return Outcome(state, spend(), True)


def _is_due(step: int, interval: int) -> bool:
    return interval > 0 and step % interval == 0


def check_finite(metrics: dict, step: int):
    """Raise where a step's loss or gradient is not finite, naming the first culprit.

    Raises:
      NonFiniteError: with the step (counted from 0) and the name.
    """
    for name in ("reprojection", "color", "student", "loss"):
        if name in metrics and not np.isfinite(metrics[name]):
            raise NonFiniteError(
                f"The {name} loss became {float(metrics[name])} at step {step}, where "
                "a finite number was expected; start a run in another workdir with a "
                "lower train.learning_rate. The last checkpoint is kept."
            )
    for name, norm in metrics["gradient_norms"].items():
        if not np.isfinite(norm):
            raise NonFiniteError(
                f"The gradient of the {name} parameters became {float(norm)} at step "
                f"{step}, where a finite number was expected; start a run in another "
                "workdir with a lower train.learning_rate. The last checkpoint is kept."
            )


def summarize(window: list[dict], settings: Settings) -> dict:
    """Means over the steps of a window, and how often each head won."""
    window = jax.device_get(window)
    names = [n for n in window[0] if n not in ("winners", "gradient_norms")]
    record = {n: float(np.mean([m[n] for m in window])) for n in names}
    for name in window[0]["gradient_norms"]:
        norms = [m["gradient_norms"][name] for m in window]
        record[f"gradient_norm_{name}"] = float(np.mean(norms))
    if settings.num_candidates > 1:
        heads = np.concatenate([m["winners"] for m in window]) % settings.num_candidates
        counts = np.bincount(heads, minlength=settings.num_candidates)
        record["head_shares"] = [round(float(c), 4) for c in counts / counts.sum()]
    return record


def _describe(step: int, scores: dict[str, float]) -> str:
    """One line of validation metrics, of those that there is a truth for."""
    shown = (
        ("pose_accuracy", "pose accuracy {:.2f}"),
        ("pose_median_error_deg", "median error {:.1f}°"),
        ("chamfer", "Chamfer {:.2f}"),
        ("silhouette_iou", "silhouette overlap {:.2f}"),
    )
    parts = [text.format(scores[name]) for name, text in shown if name in scores]
    return f"Validation at step {step}: {', '.join(parts)}"
