"""The test views that a report shows: the worst, those in the middle, the best."""

from typing import NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points
from dpc_jax.evaluation.scores import Scores
from dpc_jax.learning.inference.evaluator import compare_silhouettes, read_view
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.reporting.examples import Example
from dpc_jax.run.report.training_shapes import TrainingShapes

GROUPS = ("Worst", "Median", "Best")


class Judged(NamedTuple):
    """Predictions for a data set, and how good they are."""

    predictions: Predictions
    dataset: DataSet
    alignment: Alignment  # from the network's frame to the object frame
    scores: Scores
    distance: float  # of the camera
    threshold: float | None = None  # of the surfaces of a voxel model; None of others


def choose_views(
    badness: np.ndarray, models: np.ndarray, *, per_group: int
) -> list[tuple[str, int, int]]:
    """The worst, median and best views: (group, row, place), no view twice.

    Args:
      badness: [n, V] of each view, higher is worse.
      models: [n, V] its object, of which a group shows one view.
      per_group: views of each, of different objects.
    """
    best = np.argsort(badness, axis=None, kind="stable")
    from_middle = np.abs(np.arange(len(best)) - (len(best) - 1) / 2)
    median = best[np.argsort(from_middle, kind="stable")]
    objects, width = np.ravel(models).tolist(), badness.shape[1]
    found: list[tuple[str, int]] = []
    # By turns, so that where there are few views each group has some.
    for _ in range(per_group):
        for group, order in zip(GROUPS, (best[::-1], median, best), strict=True):
            taken = {index for _, index in found}
            shown = {objects[index] for name, index in found if name == group}
            free = (i for i in order.tolist() if i not in taken)
            index = next((i for i in free if objects[i] not in shown), None)
            found += [] if index is None else [(group, index)]
    found.sort(key=lambda one: GROUPS.index(one[0]))
    return [(group, index // width, index % width) for group, index in found]


def choose_examples(
    judged: Judged, *, per_group: int, shapes: TrainingShapes | None
) -> tuple[list[Example], str]:
    """The worst, median and best views, and a sentence on how they were chosen.

    They are ranked by the pose error; where poses are not predicted, or their truth is
    not known, by the Chamfer distance, and without true shapes by the overlap of
    silhouettes.

    Args:
      per_group: views of each. shapes: to show beside them.
    """
    models, _ = arrange_views(judged.dataset)
    scores = judged.scores
    overlaps = compare_silhouettes(judged.predictions, judged.dataset)[..., 0]
    badness, measure = -overlaps, "overlap of silhouettes"
    if scores.failures is not None:
        badness, measure = scores.failures.errors_deg, "pose error"
    elif scores.chamfers is not None:
        badness, measure = scores.chamfers.sum(axis=-1), "Chamfer distance"
    examples = [
        _make_example(judged, *chosen, overlaps=overlaps, shapes=shapes)
        for chosen in choose_views(badness, models, per_group=per_group)
    ]
    return examples, f"The worst, median and best of all test views by {measure}."


def _make_example(
    judged: Judged,
    group: str,
    row: int,
    place: int,
    *,
    overlaps: np.ndarray,
    shapes: TrainingShapes | None,
) -> Example:
    """What is shown of a view."""
    predictions, dataset, alignment, scores, distance, threshold = judged
    models, views = arrange_views(dataset)
    model, view = models[row, place], views[row, place]
    failures, chamfers, colors = scores.failures, scores.chamfers, predictions.colors
    surface = None if dataset.surfaces is None else np.asarray(dataset.surfaces[model])
    mesh, neighbours = None, ()
    if threshold is not None:
        # It needs libraries of its own.
        from dpc_jax.learning.inference.volumes import find_surface

        mesh = find_surface(predictions, row, threshold, alignment, place=place)
    points = align_points(alignment, predictions.points[row, place])
    error = None if failures is None else float(failures.errors_deg[row, place])
    chamfer = None if chamfers is None else 100 * float(chamfers[row, place].sum())
    if shapes is not None and surface is not None:
        neighbours = shapes.list_neighbours(surface, len(points))
    several = dataset.counts[model] > 1
    return Example(
        name=dataset.names[model] + (f", view {view}" if several else ""),
        image=np.asarray(dataset.images[model, view]),
        target=np.asarray(dataset.masks[model, view]) / 255,
        predicted=predictions.silhouettes[row, place],
        points=points,
        colors=None if colors is None else colors[row, place],
        pose_error_deg=error,
        mesh=mesh,
        surface=surface,
        images=read_view(predictions, dataset, row, place, distance=distance),
        group=group,
        chamfer=chamfer,
        overlap=float(overlaps[row, place]),
        neighbours=neighbours,
    )
