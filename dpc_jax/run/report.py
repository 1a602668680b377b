"""What a finished run reports: scores of its test sets, figures, examples."""

import resource

import numpy as np

from dpc_jax.evaluation import candidates as candidate_use
from dpc_jax.evaluation.alignment import align_points
from dpc_jax.evaluation.metrics import REQUIRED_METRICS
from dpc_jax.learning import evaluator
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.page import write_report
from dpc_jax.run.workdir import write_alignment

EXAMPLES = 8  # test inputs shown in the report


def report_run(
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
    """Score the test sets and write WORKDIR/report.

    Args:
      sets: by name; "test", and "own" where objects of the training source are tested
        apart. predictions: of these two.
      outcome: of the training loop. records: of its log.
    """
    test = sets["test"]
    result, shares = evaluator.score(
        predictions["test"], test, alignment=alignment, num_candidates=num_candidates
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
    own = {}
    if "own" in sets:
        own = evaluator.score(
            predictions["own"],
            sets["own"],
            alignment=alignment,
            num_candidates=num_candidates,
        )[0].metrics
        metrics |= {f"own_{name}": value for name, value in own.items()}
        metrics["own_test_models"] = len(sets["own"].names)
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
        examples=_make_examples(predictions["test"], test, alignment, result),
        pose_errors=result.pose_errors_deg,  # None: no such figure
        shares=shares if num_candidates > 1 else None,
        warnings=warnings,
        config_text=str(config),
    )
    if config.pose.known or sets["val"].quaternions is not None:
        write_alignment(workdir, alignment)
    for warning in warnings:
        print(f"Warning: {warning}")
    print(f"Test: {_describe(metrics)} after {outcome.seconds:.0f} s of training.")
    if own:
        print(f"Objects of the training source: {_describe(own)}.")
    print(f"Report: {path}")


def _describe(metrics) -> str:
    shown = (
        ("pose_accuracy", "pose accuracy {:.3f}"),
        ("pose_median_error_deg", "median error {:.1f}°"),
        ("chamfer", "Chamfer {:.2f}"),
        ("silhouette_iou", "silhouette overlap {:.3f}"),
    )
    found = [t.format(metrics[n]) for n, t in shown if metrics.get(n) is not None]
    return ", ".join(found)


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
