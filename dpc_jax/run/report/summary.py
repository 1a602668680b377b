"""What a finished run reports: scores of its test sets, costs, warnings, the page."""

import resource
from pathlib import Path
from typing import Any

from dpc_jax.config import Config, to_config_dict
from dpc_jax.data import DataSet
from dpc_jax.evaluation import candidates as candidate_use
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.densification import DENSE_POINTS
from dpc_jax.evaluation.failures import Failures
from dpc_jax.evaluation.metrics import REQUIRED_METRICS, describe_metrics
from dpc_jax.learning import schedules
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.inference.view_images import (
    MEASURES,
    measure_cameras,
    measure_images,
)
from dpc_jax.learning.training.loop import Outcome
from dpc_jax.reporting.page import write_report
from dpc_jax.run.report.examples import choose_examples, list_view_poses
from dpc_jax.run.report.training_shapes import TrainingShapes, compare
from dpc_jax.run.report.warnings import list_warnings
from dpc_jax.run.report.worst_objects import list_worst
from dpc_jax.run.workdir import write_alignment


def report_run(
    workdir: Path,
    config: Config,
    sets: dict[str, DataSet],
    outcome: Outcome,
    *,
    predictions: dict[str, Predictions],
    alignment: Alignment,
    records: list[dict],
    data_seconds: float,
    threshold: float | None = None,
    refined: dict[str, Any] | None = None,
):
    """Score the test sets, write WORKDIR/report, and print what is in it.

    Args:
      sets: by name; "test", and "own" where objects of the training source are tested
        apart. predictions: of these two.
      outcome: of the training loop. records: of its log.
      data_seconds: spent on preparing the data.
      threshold: of the surfaces of a voxel model.
      refined: of `measure_refinement`, where it was asked for.
    """
    heads = config.pose.heads
    scored = {
        name: evaluator.score(
            found,
            sets[name],
            alignment=alignment,
            heads=heads,
            poses_given=config.pose.known,
            # Maps and volumes are judged by ten thousand points already.
            dense_points=DENSE_POINTS if config.network.shape == "points" else 0,
        )
        for name, found in predictions.items()
    }
    result, shares = scored["test"]
    measured = {
        name: measure_images(found, sets[name], distance=config.render.distance)
        | measure_cameras(found, sets[name])
        for name, found in predictions.items()
    }
    metrics = dict.fromkeys((*REQUIRED_METRICS, *MEASURES)) | result.metrics
    metrics |= measured["test"]
    failures = None
    if not config.pose.known:
        failures = evaluator.diagnose(
            predictions["test"], sets["test"], alignment=alignment
        )
        metrics |= failures.metrics if failures else {}
    metrics |= _count_costs(sets, outcome, data_seconds)
    metrics["candidates_alive"] = candidate_use.count_alive(shares) if heads else None
    if sets["test"].quaternions is not None and not config.pose.given:
        metrics["alignment_inlier_share"] = alignment.inlier_share
    if "own" in scored:
        own = scored["own"][0].metrics | measured["own"]
        metrics |= {f"own_{name}": value for name, value in own.items()}
        metrics["own_test_models"] = len(sets["own"].names)
    metrics |= refined or {}
    if threshold is not None:
        metrics["surface_threshold"] = threshold
    warnings = list_warnings(config, sets, shares if heads > 1 else None)
    shapes = TrainingShapes.gather(sets)
    examples, ranking = choose_examples(
        predictions["test"],
        sets["test"],
        alignment,
        result,
        per_group=config.log.examples,
        shapes=shapes,
        distance=config.render.distance,
        threshold=threshold,
    )
    path = write_report(
        workdir / "report",
        title=f"dpc_jax: {workdir.name}",
        metrics=metrics,
        records=records,
        stages=list_stages(config),
        examples=examples,
        ranking=ranking,
        worst=list_worst(
            predictions["test"],
            sets["test"],
            alignment,
            result,
            distance=config.render.distance,
        ),
        pose_errors=result.pose_errors_deg,  # None: no such figure
        view_poses=list_view_poses(
            predictions["test"], sets["test"], alignment, result, failures
        ),
        lost=_name_lost(failures, sets["test"]),
        comparison=compare(predictions["test"], sets["test"], alignment, shapes),
        shares=shares if heads > 1 else None,
        warnings=warnings,
        config_text=str(to_config_dict(config)),
    )
    if config.pose.given or sets["val"].quaternions is not None:
        write_alignment(workdir, alignment)
    for warning in warnings:
        print(f"Warning: {warning}")
    print(
        f"Test: {describe_metrics(metrics)} after {outcome.seconds:.0f} s of training."
    )
    for line in describe_refined(refined or {}):
        print(line)
    if "own" in scored:
        own = scored["own"][0].metrics
        print(f"Objects of the training source: {describe_metrics(own)}.")
    print(f"Report: {path}")


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
