"""Hand-tuned and learned sizes of points (appendix "Towards part-based models")."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.evaluation.alignment import align_points
from dpc_jax.learning import schedules
from dpc_jax.learning.inference.predictor import (
    Predictions,
    arrange_views,
    make_predictor,
    predict_all,
)
from dpc_jax.reporting import paper_figures as figures
from dpc_jax.run.trained import load_split, load_trained
from dpc_jax.run.workdir import read_config, read_metrics

SHOWN = 5  # chairs in a figure


def run(out: Path, workdirs: Sequence[Path]) -> tuple[dict, list[tuple[Path, str]]]:
    """No measures, and the figures of finished runs of all kinds with captions.

    One has the projection errors of all runs whose reports know them; the other what
    the first run of each kind renders, and its Gaussians as ellipsoids.
    """
    errors: dict[str, dict[int, list[float]]] = {}
    firsts: dict[str, Path] = {}
    for workdir in workdirs:
        config, metrics = read_config(workdir), read_metrics(workdir) or {}
        kind, count = config.network.point_size, config.render.num_points
        firsts.setdefault(kind, workdir)
        error = metrics.get("projection_error")
        if error is not None:
            errors.setdefault(kind, {}).setdefault(count, []).append(float(error))
    found = []
    if errors:
        path = figures.draw_projection_errors(errors, out / "projection_error.svg")
        caption = "Projection error against the number of points: mean and single runs."
        found.append((path, caption))
    shapes = {kind: predict_gaussians(workdir) for kind, workdir in firsts.items()}
    path = figures.draw_gaussians(shapes, out / "gaussians.png")
    caption = (
        "Input, true silhouette, what the points of each kind render, and their "
        "Gaussians as ellipsoids, all seen from one side; a point has one colour."
    )
    return {}, [*found, (path, caption)]


def predict_gaussians(workdir: Path) -> list[figures.Gaussians]:
    """Shapes of the first views of test objects, spread over the split."""
    trained = load_trained(workdir)
    config, step = trained.config, trained.state.step
    dataset = load_split(trained, "test")
    predictor = make_predictor(trained.network, config)
    predictions = predict_all(predictor, trained.state, dataset)
    sigma = schedules.compute_sigma(step, config.render, steps=config.train.steps)
    covariances = find_covariances(predictions, float(sigma), grid=config.render.grid)
    turn = align_points(trained.alignment, np.eye(3)).T
    models, views = arrange_views(dataset)
    shapes = []
    for row in np.linspace(0, len(models) - 1, min(SHOWN, len(models))).astype(int):
        place = models[row, 0], views[row, 0]
        shapes.append(
            figures.Gaussians(
                image=np.asarray(dataset.images[place]),
                target=np.asarray(dataset.masks[place]) / 255,
                predicted=predictions.silhouettes[row, 0],
                points=align_points(trained.alignment, predictions.points[row, 0]),
                covariances=turn @ covariances[row, 0] @ turn.T,
            )
        )
    return shapes


def find_covariances(
    predictions: Predictions, sigma: float, *, grid: int
) -> np.ndarray:
    """Covariances [M, V, N, 3, 3] in squares of the object's unit.

    Args:
      sigma: of predictions without sizes of each point, voxels.
      grid: side of the volume, in voxels.
    """
    sizes = predictions.sizes
    if sizes is None:
        sizes = np.full(predictions.points.shape[:3], sigma)
    if sizes.ndim == 3:
        sizes = sizes[..., None, None] ** 2 * np.eye(3)
    return sizes / grid**2
