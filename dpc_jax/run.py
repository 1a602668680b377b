"""One run from config to report: data, training, evaluation, report."""

import os
import resource
import signal
import sys
import time
from pathlib import Path

import ml_collections
import numpy as np

from dpc_jax import configuration
from dpc_jax.data import load_or_render
from dpc_jax.evaluation import candidates as candidate_use
from dpc_jax.evaluation.alignment import align_points, identity_alignment
from dpc_jax.learning import evaluator, loop
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.log import MetricLog
from dpc_jax.learning.step import init_state
from dpc_jax.process import keep_freed_memory
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.page import REQUIRED_METRICS, write_report
from dpc_jax.workdir import claim_workdir

EXAMPLES = 8  # test inputs shown in the report


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
            "--config.train.models_per_batch lower or add mesh files."
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
    _report(
        workdir,
        config,
        sets,
        outcome,
        predictions=predict(outcome.state, "test"),
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


def _name_left_out(dataset) -> list[str]:
    """A sentence on the metrics that a test set has no truth for."""
    if dataset.quaternions is None:
        return [
            "The test images come without poses and true shapes: pose errors, Chamfer "
            "distance, precision and coverage are left out."
        ]
    if dataset.surfaces is None:
        return [
            "The test images come without true shapes: Chamfer distance, precision and "
            "coverage are left out."
        ]
    return []


def _report(
    workdir,
    config,
    sets,
    outcome,
    *,
    predictions,
    alignment,
    records,
    data_seconds,
    num_candidates,
):
    """Score the test split and write WORKDIR/report."""
    test = sets["test"]
    result, shares = evaluator.score(
        predictions, test, alignment=alignment, num_candidates=num_candidates
    )
    metrics = dict.fromkeys(REQUIRED_METRICS) | result.metrics
    metrics |= {
        "train_seconds": round(outcome.seconds, 1),
        "data_seconds": round(data_seconds, 1),
        # Linux gives kilobytes; render processes are not counted in.
        "peak_memory_gb": round(
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2
        ),
        "steps": int(outcome.state.step),
        "train_models": len(sets["train"].names),
        "test_models": len(test.names),
        "candidates_alive": candidate_use.count_alive(shares),
        "alignment_inlier_share": (
            None if test.quaternions is None else alignment.inlier_share
        ),
    }
    warnings = _name_left_out(test)
    if num_candidates > 1:
        warning = candidate_use.collapse_warning(shares)
        warnings += [warning] if warning else []
    skipped = [s for split in sets.values() for s in split.skipped]
    if skipped:
        named = "; ".join(f"{name}: {reason}" for name, reason in skipped[:10])
        warnings.append(f"{len(skipped)} models were skipped ({named}).")
    remarks = [r for split in sets.values() for r in split.remarks]
    if remarks:
        named = "; ".join(f"{name}: {remark}" for name, remark in remarks[:10])
        warnings.append(f"{len(remarks)} remarks on the data ({named}).")
    path = write_report(
        workdir / "report",
        title=f"dpc_jax: {workdir.name}",
        metrics=metrics,
        records=records,
        examples=_make_examples(predictions, test, alignment, result),
        pose_errors=result.pose_errors_deg,  # None: no such figure
        shares=shares if num_candidates > 1 else None,
        warnings=warnings,
        config_text=str(config),
    )
    for warning in warnings:
        print(f"Warning: {warning}")
    shown = (
        ("pose_accuracy", "pose accuracy {:.3f}"),
        ("pose_median_error_deg", "median error {:.1f}°"),
        ("chamfer", "Chamfer {:.2f}"),
        ("silhouette_iou", "silhouette overlap {:.3f}"),
    )
    found = [t.format(metrics[n]) for n, t in shown if metrics.get(n) is not None]
    print(f"Test: {', '.join(found)} after {outcome.seconds:.0f} s of training.")
    print(f"Report: {path}")


def _make_examples(predictions, dataset, alignment, result) -> list[Example]:
    """The first views of test models spread over the split."""
    models, views = evaluator.arrange_views(dataset)
    errors, colors = result.pose_errors_deg, predictions.colors
    examples = []
    for row in np.linspace(0, len(models) - 1, min(EXAMPLES, len(models))).astype(int):
        model, view = models[row, 0], views[row, 0]
        surfaces = dataset.surfaces
        examples.append(
            Example(
                name=dataset.names[model],
                image=np.asarray(dataset.images[model, view]),
                target=np.asarray(dataset.masks[model, view]) / 255,
                predicted=predictions.silhouettes[row, 0],
                points=align_points(alignment, predictions.points[row, 0]),
                colors=None if colors is None else colors[row, 0],
                pose_error_deg=None if errors is None else float(errors[row, 0]),
                surface=None if surfaces is None else np.asarray(surfaces[model]),
            )
        )
    return examples


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
