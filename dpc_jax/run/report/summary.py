"""What a finished run reports: scores of its test sets, costs, warnings, the page."""

import resource
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config import Config, to_config_dict
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.density import DENSE_POINTS
from dpc_jax.evaluation.metrics import REQUIRED_METRICS, describe_metrics
from dpc_jax.evaluation.pose import Failures, collapse_warning, count_alive
from dpc_jax.learning import schedules
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.training.loop import Outcome
from dpc_jax.reporting.page import write_report
from dpc_jax.run.report.examples import (
    Judged,
    choose_examples,
    list_view_poses,
    list_worst,
)
from dpc_jax.run.report.training_shapes import TrainingShapes, compare_with_training
from dpc_jax.run.setup import collect_warnings
from dpc_jax.run.workdir import write_alignment

_FEW_STEPS = 1000  # before which heads have hardly begun to share the views


def report_run(
    workdir: Path,
    config: Config,
    sets: dict[str, DataSet],
    outcome: Outcome,
    *,
    predictions: Predictions,
    alignment: Alignment,
    records: list[dict],
    data_seconds: float,
    threshold: float | None = None,
    refined: dict[str, Any] | None = None,
):
    """Score the test sets, write WORKDIR/report, and print what is in it.

    Args:
      sets: by name. predictions: of "test".
      outcome: of the training loop. records: of its log.
      data_seconds: spent on preparing the data.
      threshold: of the surfaces of a voxel model.
      refined: of `measure_refinement`, where it was asked for.
    """
    test, shares, values = _judge(
        predictions, sets["test"], config, alignment, threshold
    )
    failures = None
    if not config.pose.known:
        failures = evaluator.diagnose(*test[:2], alignment=alignment)
    metrics = dict.fromkeys((*REQUIRED_METRICS, *evaluator.MEASURES)) | values
    metrics |= failures.metrics if failures else {}
    metrics |= _count_costs(sets, outcome, data_seconds)
    heads = config.pose.heads
    metrics["candidates_alive"] = count_alive(shares) if heads else None
    if test.dataset.quaternions is not None and not config.pose.aligned:
        metrics["alignment_inlier_share"] = alignment.inlier_share
    metrics |= refined or {}
    if threshold is not None:
        metrics["surface_threshold"] = threshold
    shares = shares if heads > 1 else None
    warnings = list_warnings(config, sets, shares)
    shown = {"metrics": metrics, "records": records, "shares": shares}
    shown |= {"warnings": warnings, "title": f"dpc_jax: {workdir.name}"}
    path = _write_page(workdir / "report", config, sets, test, failures, shown)
    if config.pose.aligned or sets["val"].quaternions is not None:
        write_alignment(workdir, alignment)
    for warning in warnings:
        print(f"Warning: {warning}")
    print(
        f"Test: {describe_metrics(metrics)} after {outcome.seconds:.0f} s of training."
    )
    for line in describe_refined(refined or {}):
        print(line)
    print(f"Report: {path}")


def _judge(predictions, dataset, config, alignment, threshold):
    """A judged set, the share [K] of its views that each head wins, its metrics."""
    scores, shares = evaluator.score(
        predictions,
        dataset,
        alignment=alignment,
        heads=config.pose.heads,
        poses_given=config.pose.known,
        # Maps and volumes are judged by ten thousand points already.
        dense_points=DENSE_POINTS if config.network.shape == "points" else 0,
    )
    distance = config.render.distance
    overlaps = evaluator.measure_overlaps(predictions, dataset)
    judged = Judged(
        predictions, dataset, alignment, scores, overlaps, distance, threshold
    )
    metrics = (
        scores.metrics
        | evaluator.measure_images(predictions, dataset, distance=distance)
        | evaluator.measure_cameras(predictions, dataset)
    )
    return judged, shares, metrics


def _write_page(folder, config, sets, judged: Judged, failures, shown: dict) -> Path:
    """The report of the test set; `shown` are further arguments of `write_report`."""
    shapes = TrainingShapes.gather(sets)
    # The worst, median and best are of different models where there are enough.
    per_group = max(1, min(3, len(judged.dataset.names) // 3))
    examples, ranking = choose_examples(judged, per_group=per_group, shapes=shapes)
    return write_report(
        folder,
        stages=list_stages(config),
        examples=examples,
        ranking=ranking,
        worst=list_worst(judged),
        pose_errors=judged.scores.pose_errors_deg,  # None: no such figure
        view_poses=list_view_poses(judged, failures),
        lost=_name_lost(failures, judged.dataset),
        comparison=compare_with_training(*judged[:3], shapes),
        config_text=str(to_config_dict(config)),
        **shown,
    )


def list_warnings(
    config: Config, sets: dict[str, DataSet], shares: np.ndarray | None
) -> list[str]:
    """Sentences on what a reader of the figures has to know.

    Args:
      sets: by name. shares: [K] of views that each head wins; None without an ensemble.
    """
    warnings = collect_warnings(config, sets) + _name_left_out(sets["test"])
    if config.pose.known:
        warnings.append(
            "This run was given the poses and learned none: pose accuracy and pose "
            "errors are absent."
        )
    if shares is not None:
        warning = collapse_warning(shares)
        if warning and config.train.steps < _FEW_STEPS:
            warning += f" After {config.train.steps} steps that tells nothing yet."
        warnings += [warning] if warning else []
    for one, many, pairs in (
        (
            "1 model was skipped",
            "{} models were skipped",
            [s for data in sets.values() for s in data.skipped],
        ),
        (
            "1 remark on the data",
            "{} remarks on the data",
            [r for data in sets.values() for r in data.remarks],
        ),
    ):
        if pairs:
            text = one if len(pairs) == 1 else many.format(len(pairs))
            named = "; ".join(f"{name}: {reason}" for name, reason in pairs[:10])
            warnings.append(f"{text} ({named}).")
    return warnings


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


def describe_refined(refined: dict[str, Any]) -> list[str]:
    """Sentences on the figures of `measure_refinement`."""
    titles = {
        "refined_": "Refined, each view on its own",
        "joined_": "All views of an object together",
        "refined_joined_": "Together and refined",
    }
    return [
        f"{title}: "
        + describe_metrics(
            {
                name: refined[start + name]
                for name in ("pose_accuracy", "pose_median_error_deg", "chamfer")
                if start + name in refined
            }
        )
        + "."
        for start, title in titles.items()
        if any(name.startswith(start) for name in refined)
    ]


def _name_lost(failures: Failures | None, dataset: DataSet) -> list[str]:
    """Names of objects that are wrong in all their views."""
    if failures is None:
        return []
    models, _ = arrange_views(dataset)
    return [dataset.names[models[row, 0]] for row in failures.wrong_objects]


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
        "alignment_inlier_share": None,
    }


def list_stages(config: Config) -> list[tuple[int, str]]:
    """The first step of each stage of the schedule, and what is new in it."""
    spans = schedules.list_spans(config.render, steps=config.train.steps)
    stages = []
    for before, span in zip((None, *spans), spans, strict=False):
        old = before.stage if before else None
        points, side = span.stage.kept_points, span.stage.grid
        new = [f"{points} points"] if not old or old.kept_points != points else []
        new += [f"{side}³ cells"] if not old or old.grid != side else []
        if old and old.fixed_views and not span.stage.fixed_views:
            new.append("free views")
        stages.append((span.start, ", ".join(new)))
    return stages
