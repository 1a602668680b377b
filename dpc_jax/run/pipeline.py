"""One run from config to report: data, training, evaluation, report."""

import os
import signal
import sys
import time
from pathlib import Path
from typing import NamedTuple, Self

from dpc_jax import config as configs
from dpc_jax.config import Config
from dpc_jax.data import DataSet, load_or_render
from dpc_jax.evaluation.alignment import Alignment, identity_alignment
from dpc_jax.learning import evaluator, loop
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.log import MetricLog
from dpc_jax.learning.predictor import Predictions, make_predictor, predict_all
from dpc_jax.learning.records import NonFiniteError
from dpc_jax.learning.step import TrainState, init_state
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.process import keep_freed_memory
from dpc_jax.run.report import report_run
from dpc_jax.run.setup import make_data_specs, make_network
from dpc_jax.run.workdir import claim_workdir


def run_guarded(config: Config, *, config_path: str, workdir: str | None) -> int:
    """`run`, with expected failures as one sentence and an exit status."""
    try:
        run(config, config_path=config_path, workdir=workdir)
    except (ValueError, OSError, NonFiniteError) as error:
        if os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Interrupted; start again in the same workdir to go on.", file=sys.stderr)
        return 130
    return 0


def run(config: Config, *, config_path: str, workdir: str | None):
    """Train where that is left to do, then evaluate on the test split and report.

    Args:
      config: of the run.
      config_path: file it came from, for the default workdir's name.
      workdir: folder of the run; runs/NAME-seedN where None.

    Raises:
      ValueError: for a config that cannot work, or a workdir made by another one.
      OSError: where the workdir cannot be written.
      NonFiniteError: where training breaks.
    """
    configs.check(config)
    keep_freed_memory()
    folder = claim_workdir(Path(workdir or _name_workdir(config, config_path)), config)
    print(f"Workdir: {folder}", flush=True)

    started = time.monotonic()
    sets = load_sets(config)
    data_seconds = time.monotonic() - started

    model = Model(config, sets)
    log = MetricLog(folder / "metrics.jsonl")
    outcome = train_model(model, folder, log)
    if not outcome.is_finished:
        print(
            f"Stopped and saved at step {int(outcome.state.step)}; start again in the "
            "same workdir to go on."
        )
        return
    state = outcome.state
    report_run(
        folder,
        config,
        sets,
        outcome,
        predictions={
            name: model.predict(state, name) for name in ("test", "own") if name in sets
        },
        alignment=model.align(model.predict(state, "val")),
        records=log.read(),
        data_seconds=data_seconds,
    )


def _name_workdir(config, config_path):
    """runs/car-paper-seed0, for instance."""
    variant = config.variant.replace(",", "-")
    parts = (Path(config_path).stem, variant, f"seed{config.seed}")
    return Path("runs") / "-".join(part for part in parts if part)


def load_sets(config: Config) -> dict[str, DataSet]:
    """The data sets of a run: "train", "val", "test", and "own" where asked for.

    Raises:
      ValueError: where a set cannot be used, or does not fit the config.
      OSError: where the cache cannot be written.
    """
    sets = {
        split: load_or_render(
            spec,
            cache_dir=config.data.cache_dir,
            processes=config.data.processes or None,
        )
        for split, spec in make_data_specs(config).items()
    }
    wanted, found = config.train.models_per_batch, len(sets["train"].names)
    if wanted > found:
        raise ValueError(
            f"A batch of train.models_per_batch = {wanted} models was asked for, but "
            f"{found} can be trained on; set --config.train.models_per_batch lower or "
            "add models."
        )
    lacking = [name for name, data in sets.items() if data.quaternions is None]
    if config.pose.known and lacking:
        raise ValueError(
            "Training with known poses was asked for, but the "
            f"{' and '.join(lacking)} images come without; add poses.json or "
            "transforms.json to every object, or set --config.pose.known=False."
        )
    return sets


class Model:
    """What a run learns, with its data sets: the network and how it is judged."""

    def __init__(self, config: Config, sets: dict[str, DataSet]):
        self.config, self.sets = config, sets
        self.network: ShapePoseNetwork = make_network(config)
        self._predictor = make_predictor(self.network, config)

    def predict(self, state: TrainState, split: str) -> Predictions:
        """Predictions for a split."""
        return predict_all(self._predictor, state, self.sets[split])

    def align(self, predictions: Predictions) -> Alignment:
        """Canonical alignment, from predictions for the validation split."""
        if self.config.pose.known:
            return identity_alignment()
        return evaluator.align(predictions, self.sets["val"])

    def validate(self, state: TrainState) -> dict[str, float]:
        """Metrics on the validation split."""
        predictions = self.predict(state, "val")
        result, _ = evaluator.score(
            predictions,
            self.sets["val"],
            alignment=self.align(predictions),
            heads=self.config.pose.heads,
            chamfer_views=1,
        )
        return result.metrics


class Start(NamedTuple):
    """Where training begins: the state, and the seconds of training behind it."""

    state: TrainState
    seconds: float


def restore_start(model: Model, checkpoints: Checkpoints, log: MetricLog) -> Start:
    """The newest checkpoint that can be read, or step 0; the log is cut to fit.

    Raises:
      ValueError: if there are checkpoints, yet none can be read.
    """
    state, seconds = init_state(model.network, model.config), 0.0
    restored = checkpoints.restore(state)
    if restored is not None:
        state, seconds = restored.state, restored.seconds
        for step in restored.damaged:
            print(f"The checkpoint of step {step} is damaged; the one before is used.")
        if restored.damaged:
            checkpoints.set_aside(restored.damaged)
        print(f"Going on from the checkpoint of step {int(state.step)}.", flush=True)
    log.cut_after(int(state.step))
    return Start(state, seconds)


def train_model(model: Model, workdir: Path, log: MetricLog) -> loop.Outcome:
    """Train to the last step, or until SIGTERM asks to save and stop.

    Raises:
      ValueError: if there are checkpoints, yet none can be read.
      NonFiniteError: where training breaks.
    """
    checkpoints = Checkpoints(workdir / "checkpoints")
    state, seconds = restore_start(model, checkpoints, log)
    outcome = loop.Outcome(state, seconds, True)
    if int(state.step) < model.config.train.steps:
        with _StopSignal() as stop:
            outcome = loop.train(
                state,
                model.sets["train"],
                network=model.network,
                config=model.config,
                checkpoints=checkpoints,
                log=log,
                evaluate=model.validate,
                should_stop=stop.is_set,
                seconds=seconds,
                title=f"Training {workdir.name}",
            )
    checkpoints.close()
    return outcome


class _StopSignal:
    """Turns SIGTERM into a flag, so that a run saves before it ends."""

    def __init__(self):
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def __enter__(self) -> Self:
        def handle(*_):
            self._is_set = True

        self._before = signal.signal(signal.SIGTERM, handle)
        return self

    def __exit__(self, *_: object):
        signal.signal(signal.SIGTERM, self._before)
