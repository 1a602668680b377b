"""Hand-tuned and learned sizes of points (appendix "Towards part-based models")."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet, load_or_render
from dpc_jax.evaluation.alignment import align_points
from dpc_jax.learning import schedules
from dpc_jax.learning.inference.predictor import (
    VIEWS_AT_ONCE,
    Predictions,
    arrange_views,
    make_predictor,
    predict_all,
)
from dpc_jax.reporting import point_sizes as figures
from dpc_jax.run.finished import restore_state
from dpc_jax.run.setup import make_data_specs, make_network
from dpc_jax.run.workdir import read_alignment, read_config

SHOWN = 5  # chairs in a figure


class Run(NamedTuple):
    """A finished run, as the figures need it."""

    workdir: Path
    config: Config
    error: float  # projection error on the test views
    validation: float  # the same on those that hand-tuned sizes are chosen by


def draw(
    out: str | Path, workdirs: Sequence[str | Path]
) -> tuple[dict[str, float], list[Path]]:
    """The appendix's figures from finished runs of known poses.

    The runs may be of any kinds, numbers of points and seeds. Where several hand-tuned
    sigmas were tried for a number of points, the one with the least error on the
    validation views is taken.

    Args:
      out: folder of the figures. workdirs: of the runs.

    Returns:
      ({"projection_error_KIND_N": mean over seeds} with the kinds hand_tuned, sigma and
      covariance, and {"hand_tuned_sigma_N": share of the volume}; paths of figures:
      the error over the number of points, where there are several, and, for the fewest
      points that all kinds have, silhouettes and ellipsoids).

    Raises:
      ValueError: where a workdir holds no finished run.
    """
    out = Path(out)
    runs = choose_hand_tuned([read_run(Path(workdir)) for workdir in workdirs])
    errors: dict[str, dict[int, list[float]]] = {}
    metrics: dict[str, float] = {}
    for run in runs:
        kind, count = find_kind(run), run.config.render.num_points
        errors.setdefault(kind, {}).setdefault(count, []).append(run.error)
        if not kind:
            metrics[f"hand_tuned_sigma_{count}"] = run.config.render.sigma_end
    for kind, by_count in errors.items():
        for count, found in by_count.items():
            name = f"projection_error_{kind or 'hand_tuned'}_{count}"
            metrics[name] = float(np.mean(found))
    errors = {kind: errors[kind] for kind in figures.LABELS if kind in errors}
    paths = []
    if len({count for by_count in errors.values() for count in by_count}) > 1:
        paths.append(
            figures.draw_projection_errors(errors, out / "projection_error.png")
        )
    if compared := choose_compared(runs):
        shapes = {kind: predict_gaussians(run) for kind, run in compared.items()}
        paths.append(figures.draw_silhouettes(shapes, out / "silhouettes.png"))
        paths.append(figures.draw_gaussians(shapes, out / "ellipsoids.png"))
    return metrics, paths


def find_kind(run: Run) -> str:
    """What a run learns of each point's size."""
    return run.config.network.point_size


def read_run(workdir: Path) -> Run:
    """The config and errors of a finished run.

    Raises:
      ValueError: where it is not finished, or lacks the projection error.
    """
    config = read_config(workdir)
    try:
        text = (workdir / "report" / "metrics.json").read_text(encoding="utf-8")
        error = float(json.loads(text)["projection_error"])
        lines = (workdir / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
        records = [json.loads(line) for line in lines]
        found = [r["projection_error"] for r in records if "projection_error" in r]
        return Run(workdir, config, error, float(found[-1]))
    except (OSError, KeyError, IndexError, TypeError, ValueError):
        raise ValueError(
            f"Expected a finished run with a projection error in {workdir}, but there "
            "is none; start the command that began the run again."
        ) from None


def choose_hand_tuned(runs: Sequence[Run]) -> list[Run]:
    """All runs of learned sizes, and of each number of points the best fixed sigma."""
    tried: dict[int, dict[float, list[Run]]] = {}
    for run in runs:
        if not find_kind(run):
            render = run.config.render
            by_sigma = tried.setdefault(render.num_points, {})
            by_sigma.setdefault(render.sigma_end, []).append(run)
    chosen = [run for run in runs if find_kind(run)]
    for by_sigma in tried.values():
        chosen += min(
            by_sigma.values(),
            key=lambda same: float(np.mean([run.validation for run in same])),
        )
    return chosen


def choose_compared(runs: Sequence[Run]) -> dict[str, Run]:
    """A run of each kind, of the fewest points that most kinds have; {} for none."""
    by_count: dict[int, dict[str, Run]] = {}
    for run in runs:
        by_count.setdefault(run.config.render.num_points, {}).setdefault(
            find_kind(run), run
        )
    if not by_count:
        return {}
    count = min(by_count, key=lambda count: (-len(by_count[count]), count))
    return by_count[count]


def predict_gaussians(run: Run, *, shown: int = SHOWN) -> list[figures.Gaussians]:
    """Shapes of the first views of test objects, spread over the split."""
    shared = {"run": {"devices": 0}, "train": {"models_per_batch": VIEWS_AT_ONCE}}
    config = replace_fields(run.config, shared)
    state = restore_state(config, run.workdir)
    spec = make_data_specs(config)["test"]
    dataset = load_or_render(spec, cache_dir=config.data.cache_dir)
    predictor = make_predictor(make_network(config), config)
    predictions = predict_all(predictor, state, dataset)
    sigma = schedules.compute_sigma(state.step, config.render, steps=config.train.steps)
    covariances = find_covariances(
        predictions, float(jax.device_get(sigma)), grid=config.render.grid
    )
    return _gather(run, dataset, predictions, covariances, shown)


def find_covariances(
    predictions: Predictions, sigma: float, *, grid: int
) -> np.ndarray:
    """Covariances [M, V, N, 3, 3] in squares of the object's unit.

    Args:
      predictions: with sizes of each point or without. sigma: of those without, voxels.
      grid: side of the volume, in voxels.
    """
    sizes = predictions.sizes
    if sizes is None:
        sizes = np.full(predictions.points.shape[:3], sigma)
    if sizes.ndim == 3:
        sizes = sizes[..., None, None] ** 2 * np.eye(3)
    return sizes / grid**2


def _gather(run, dataset: DataSet, predictions, covariances, shown):
    """The views that are drawn; clouds stand upright where that is known."""
    alignment = read_alignment(run.workdir)
    models, views = arrange_views(dataset)
    rows = np.linspace(0, len(models) - 1, min(shown, len(models))).astype(int)
    shapes = []
    for row in rows:
        place = models[row, 0], views[row, 0]
        points, sizes = predictions.points[row, 0], covariances[row, 0]
        if alignment is not None:
            turn = align_points(alignment, np.eye(3)).T
            points, sizes = align_points(alignment, points), turn @ sizes @ turn.T
        shapes.append(
            figures.Gaussians(
                image=np.asarray(dataset.images[place]),
                target=np.asarray(dataset.masks[place]) / 255,
                predicted=predictions.silhouettes[row, 0],
                points=points,
                covariances=sizes,
            )
        )
    return shapes
