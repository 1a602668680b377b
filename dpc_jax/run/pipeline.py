"""One run from config to report: data, training, evaluation, report."""

import os
import signal
import sys
import time
from pathlib import Path

import ml_collections

from dpc_jax.data import load_or_render
from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.learning import evaluator, loop
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.log import MetricLog
from dpc_jax.learning.step import init_state
from dpc_jax.run import configuration
from dpc_jax.run.process import keep_freed_memory
from dpc_jax.run.report import report_run
from dpc_jax.run.workdir import claim_workdir


def run_guarded(config, *, config_path: str, workdir: str | None) -> int:
    """`run`, with expected failures as one sentence and an exit status."""
    try:
        run(config, config_path=config_path, workdir=workdir)
    except (ValueError, OSError, loop.NonFiniteError) as error:
        if os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Interrupted; start again in the same workdir to go on.", file=sys.stderr)
        return 130
    return 0


def run(config: ml_collections.ConfigDict, *, config_path: str, workdir: str | None):
    """Train where that is left to do, then evaluate on the test split and report.

    Args:
      config: see `defaults.default_config`.
      config_path: file it came from, for the default workdir's name.
      workdir: folder of the run; runs/NAME-seedN where None.

    Raises:
      ValueError: for a config that cannot work, or a workdir made by another one.
      OSError: where the workdir cannot be written.
      loop.NonFiniteError: where training breaks.
    """
    configuration.validate(config)
    keep_freed_memory()
    if workdir is None:
        parts = (Path(config_path).stem, config.variant, f"seed{config.seed}")
        workdir = Path("runs") / "-".join(p for p in parts if p)
    workdir = claim_workdir(Path(workdir), config)
    print(f"Workdir: {workdir}", flush=True)

    started = time.monotonic()
    settings = configuration.make_settings(config)
    network = configuration.make_network(config)
    sets = {
        split: load_or_render(
            spec,
            cache_dir=config.data.cache_dir,
            processes=config.data.processes or None,
        )
        for split, spec in configuration.make_data_specs(config).items()
    }
    if settings.models_per_batch > len(sets["train"].names):
        raise ValueError(
            f"A batch of train.models_per_batch = {settings.models_per_batch} models "
            f"was asked for, but {len(sets['train'].names)} can be trained on; set "
            "--config.train.models_per_batch lower or add models."
        )
    _check_poses(config, sets)
    data_seconds = time.monotonic() - started

    predictor = evaluator.make_predictor(network, settings)

    def predict(state, split):
        return evaluator.predict_all(predictor, state, sets[split])

    def align(predictions):
        if config.pose.known:
            return identity_alignment()
        return evaluator.align(predictions, sets["val"])

    def evaluate(state):
        predictions = predict(state, "val")
        result, _ = evaluator.score(
            predictions,
            sets["val"],
            alignment=align(predictions),
            num_candidates=settings.num_candidates,
            chamfer_views=1,
        )
        return result.metrics

    checkpoints = Checkpoints(workdir / "checkpoints")
    log = MetricLog(workdir / "metrics.jsonl")
    state = init_state(network, settings, image_size=config.data.image_size)
    restored = checkpoints.restore(state)
    seconds = 0.0
    if restored is not None:
        state, seconds = restored.state, restored.seconds
        for step in restored.damaged:
            print(f"The checkpoint of step {step} is damaged; the one before is used.")
        if restored.damaged:
            checkpoints.set_aside(restored.damaged)
        print(f"Going on from the checkpoint of step {int(state.step)}.", flush=True)
    log.cut_after(int(state.step))

    outcome = loop.Outcome(state, seconds, True)
    if int(state.step) < settings.steps:
        with _StopSignal() as stop:
            outcome = loop.train(
                state,
                sets["train"],
                network=network,
                settings=settings,
                intervals=configuration.make_intervals(config),
                checkpoints=checkpoints,
                log=log,
                evaluate=evaluate,
                should_stop=stop.is_set,
                seconds=seconds,
                title=f"Training {workdir.name}",
            )
    checkpoints.close()
    if not outcome.is_finished:
        print(
            f"Stopped and saved at step {int(outcome.state.step)}; start again in the "
            "same workdir to go on."
        )
        return
    predictions = {
        name: predict(outcome.state, name) for name in ("test", "own") if name in sets
    }
    report_run(
        workdir,
        config,
        sets,
        outcome,
        predictions=predictions,
        alignment=align(predict(outcome.state, "val")),
        records=log.read(),
        data_seconds=data_seconds,
        num_candidates=settings.num_candidates,
    )


def _check_poses(config, sets):
    """Known-pose training needs poses.

    Raises:
      ValueError: where a set has none.
    """
    lacking = [name for name, data in sets.items() if data.quaternions is None]
    if config.pose.known and lacking:
        raise ValueError(
            "Training with known poses was asked for, but the "
            f"{' and '.join(lacking)} images come without; add poses.json or "
            "transforms.json to every object, or set --config.pose.known=False."
        )


class _StopSignal:
    """Turns SIGTERM into a flag, so that a run saves before it ends."""

    def __init__(self):
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def __enter__(self):
        def handle(*_):
            self._is_set = True

        self._before = signal.signal(signal.SIGTERM, handle)
        return self

    def __exit__(self, *_):
        signal.signal(signal.SIGTERM, self._before)
