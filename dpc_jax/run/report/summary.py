"""What a finished run reports: scores of its test sets, costs, warnings, the page."""

import resource
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config import Config, to_config_dict
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.metrics import REQUIRED_METRICS, describe_metrics
from dpc_jax.evaluation.pose import collapse_warning, count_alive, winner_share
from dpc_jax.evaluation.scores import estimate_errors
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.training.loop import Outcome
from dpc_jax.reporting.page import write_report
from dpc_jax.run.learner import Learner
from dpc_jax.run.report.shown_views import Judged, choose_examples
from dpc_jax.run.report.training_shapes import TrainingShapes
from dpc_jax.run.setup import collect_warnings
from dpc_jax.run.workdir import write_alignment

_FEW_STEPS = 1000  # before which heads have hardly begun to share the views


def report_run(
    workdir: Path,
    learner: Learner,
    outcome: Outcome,
    found: tuple[Predictions, Alignment, float | None],
    records: list[dict],
    data_seconds: float,
):
    """Score the test set, write WORKDIR/report, and print what is in it.

    Args:
      found: see `Learner.predict_test`. data_seconds: spent on preparing the data.
    """
    config, sets, test = learner.config, learner.sets, learner.sets["test"]
    judged = judge(test, config, *found)
    predictions = judged.predictions
    shapes = TrainingShapes.gather(sets, predictions.points.shape[2])
    metrics = list_metrics(judged, config, shapes)
    metrics |= _count_costs(sets, outcome, data_seconds)
    heads = config.pose.learned_heads
    shares = winner_share(predictions.winners, heads=heads) if heads else None
    metrics["candidates_alive"] = None if shares is None else count_alive(shares)
    warnings = list_warnings(config, sets, shares)
    # The worst, median and best are of different models where there are enough.
    per_group = max(1, min(3, len(test.names) // 3))
    examples, ranking = choose_examples(judged, per_group=per_group, shapes=shapes)
    path = write_report(
        workdir / "report",
        title=f"dpc_jax: {workdir.name}",
        metrics=metrics,
        records=records,
        examples=examples,
        ranking=ranking,
        failures=judged.scores.failures,
        warnings=warnings,
        config_text=str(to_config_dict(config)),
    )
    if config.pose.aligned or sets["val"].quaternions is not None:
        write_alignment(workdir, judged.alignment)
    for warning in warnings:
        print(f"Warning: {warning}")
    print(
        f"Test: {describe_metrics(metrics)} after {outcome.seconds:.0f} s of training."
    )
    print(f"Report: {path}")


def measure_gains(metrics: dict[str, Any]) -> dict[str, float | None]:
    """How much of the way from the mean training shape to the floor predictions go."""
    gains = {}
    for prefix in ("", "visible_"):
        mean = metrics.get(f"{prefix}mean_shape_chamfer")
        if mean is not None:
            way = mean - metrics[f"{prefix}floor_chamfer"]
            gone = mean - metrics[f"{prefix}chamfer"]
            # Shapes that are all alike: there is no way to go.
            gains[f"{prefix}chamfer_gain"] = gone / way if way > 0 else None
    return gains


def judge(
    dataset: DataSet,
    config: Config,
    predictions: Predictions,
    alignment: Alignment,
    threshold: float | None,
) -> Judged:
    """Predictions for a data set with their scores; see `Judged`."""
    scores = evaluator.score(
        predictions, dataset, alignment=alignment, poses_given=config.pose.known
    )
    distance = config.render.distance
    return Judged(predictions, dataset, alignment, scores, distance, threshold)


def list_metrics(
    judged: Judged, config: Config, shapes: TrainingShapes | None
) -> dict[str, Any]:
    """Metrics of a judged set, None where there is nothing to measure."""
    predictions, dataset, alignment, scores, distance, threshold = judged
    metrics = dict.fromkeys(REQUIRED_METRICS) | scores.metrics | estimate_errors(scores)
    metrics |= evaluator.measure_images(predictions, dataset, distance=distance)
    metrics |= evaluator.measure_cameras(predictions, dataset)
    has_frame = dataset.quaternions is not None and not config.pose.aligned
    metrics["alignment_inlier_share"] = alignment.inlier_share if has_frame else None
    if shapes is not None and scores.chamfers is not None:
        metrics |= shapes.measure_references(predictions, dataset, alignment)
        metrics |= measure_gains(metrics)
    metrics |= scores.failures.metrics if scores.failures else {}
    return metrics | ({} if threshold is None else {"surface_threshold": threshold})


def list_warnings(
    config: Config, sets: dict[str, DataSet], shares: np.ndarray | None
) -> list[str]:
    """Sentences on what a reader of the figures has to know.

    Args:
      shares: [K] of views that each head wins; None without heads.
    """
    warnings, test = collect_warnings(sets), sets["test"]
    if test.quaternions is None:
        warnings.append(
            "The test images come without poses and true shapes: pose errors, Chamfer "
            "distance, precision and coverage are left out."
        )
    elif test.surfaces is None:
        warnings.append(
            "The test images come without true shapes: Chamfer distance, precision and "
            "coverage are left out."
        )
    if config.pose.known:
        warnings.append(
            "This run was given the poses and learned none: pose accuracy and pose "
            "errors are absent."
        )
    if shares is not None and (warning := collapse_warning(shares)):
        if config.train.steps < _FEW_STEPS:
            warning += f" After {config.train.steps} steps that tells nothing yet."
        warnings.append(warning)
    for what, field in (("Models skipped", "skipped"), ("Remarks on data", "remarks")):
        pairs = [pair for data in sets.values() for pair in getattr(data, field)]
        if pairs:
            named = "; ".join(f"{name}: {reason}" for name, reason in pairs[:10])
            warnings.append(f"{what}: {len(pairs)} ({named}).")
    return warnings


def _count_costs(sets, outcome, data_seconds) -> dict:
    """What the run cost, and what it was made of."""
    # Linux gives kilobytes; render processes are not counted in.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {
        "train_seconds": round(outcome.seconds, 1),
        "data_seconds": round(data_seconds, 1),
        "peak_memory_gb": round(peak, 2),
        "steps": int(outcome.state.step),
        "train_models": len(sets["train"].names),
        "test_models": len(sets["test"].names),
    }
