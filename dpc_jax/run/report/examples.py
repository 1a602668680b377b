"""The test views that a report shows: the worst, those in the middle, the best."""

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points, align_poses
from dpc_jax.evaluation.failures import Failures
from dpc_jax.evaluation.rotations import view_angles
from dpc_jax.evaluation.scores import Scores
from dpc_jax.learning.inference.evaluator import arrange_truth, measure_overlaps
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.inference.view_images import read_view
from dpc_jax.reporting.azimuth_figures import ViewPoses
from dpc_jax.reporting.examples import Example, SignalImages
from dpc_jax.run.report.training_shapes import TrainingShapes

GROUPS = ("Worst", "Median", "Best")


def choose_views(
    badness: np.ndarray, models: np.ndarray, *, per_group: int
) -> list[tuple[str, int, int]]:
    """The worst, median and best views: (group, row, place), no view twice.

    Args:
      badness: [n, V] of each view, higher is worse.
      models: [n, V] its object, of which a group shows one view.
      per_group: views of each, of different objects.
    """
    order = np.argsort(badness, axis=None, kind="stable")
    middle = (len(order) - 1) / 2
    from_middle = np.argsort(np.abs(np.arange(len(order)) - middle), kind="stable")
    orders = (order[::-1], order[from_middle], order)
    objects = np.ravel(models).tolist()
    found: dict[str, list[int]] = {name: [] for name in GROUPS}
    taken: set[int] = set()
    # By turns, so that where there are few views each group has some.
    for _ in range(per_group):
        for name, ranked in zip(GROUPS, orders, strict=True):
            shown = {objects[i] for i in found[name]}
            free = (i for i in ranked.tolist() if i not in taken)
            index = next((i for i in free if objects[i] not in shown), None)
            if index is not None:
                found[name].append(index)
                taken.add(index)
    width = badness.shape[1]
    chosen = [(name, index) for name in GROUPS for index in found[name]]
    return [(name, index // width, index % width) for name, index in chosen]


def choose_examples(
    predictions: Predictions,
    dataset: DataSet,
    alignment: Alignment,
    result: Scores,
    *,
    per_group: int,
    shapes: TrainingShapes | None,
    distance: float,
    threshold: float | None,
) -> tuple[list[Example], str]:
    """The views to show, and a sentence on how they were chosen.

    They are ranked by the pose error; where poses are not predicted or their truth is
    not known by the Chamfer distance, and without true shapes by the overlap of
    silhouettes.

    Args:
      result: of the predictions. per_group: the worst, median and best, of each.
      shapes: of the training set, to show beside them.
      distance: of the camera. threshold: of the surfaces of a voxel model.
    """
    models, _ = arrange_views(dataset)
    overlaps = measure_overlaps(predictions, dataset)
    badness, measure = rank_views(result, overlaps)
    examples = [
        make_example(
            predictions,
            dataset,
            alignment,
            result,
            (group, row, place),
            overlap=float(overlaps[row, place]),
            shapes=shapes,
            distance=distance,
            threshold=threshold,
        )
        for group, row, place in choose_views(badness, models, per_group=per_group)
    ]
    return examples, f"The worst, median and best of all test views by {measure}."


def rank_views(result: Scores, overlaps: np.ndarray) -> tuple[np.ndarray, str]:
    """How bad each view is [n, V], by the first measure there is, and its name."""
    if result.pose_errors_deg is not None:
        return np.asarray(result.pose_errors_deg), "pose error"
    if result.chamfers is not None:
        return np.asarray(result.chamfers).sum(axis=-1), "Chamfer distance"
    return -overlaps, "overlap of silhouettes"


def make_example(
    predictions: Predictions,
    dataset: DataSet,
    alignment: Alignment,
    result: Scores,
    chosen: tuple[str, int, int],
    *,
    overlap: float,
    shapes: TrainingShapes | None,
    distance: float,
    threshold: float | None,
) -> Example:
    """A view, (group, row, place), and what is shown of it; see `choose_examples`."""
    group, row, place = chosen
    models, views = arrange_views(dataset)
    model, view = models[row, place], views[row, place]
    errors, colors = result.pose_errors_deg, predictions.colors
    surface = None if dataset.surfaces is None else np.asarray(dataset.surfaces[model])
    mesh = None
    if threshold is not None:
        from dpc_jax.run.surfaces import find_surface  # needs libraries of its own

        mesh = find_surface(predictions, row, threshold, alignment, place=place)
    points = align_points(alignment, predictions.points[row, place])
    seen = read_view(predictions, dataset, row, place, distance=distance)
    several = dataset.counts[model] > 1
    return Example(
        name=dataset.names[model] + (f", view {view}" if several else ""),
        image=np.asarray(dataset.images[model, view]),
        target=np.asarray(dataset.masks[model, view]) / 255,
        predicted=predictions.silhouettes[row, place],
        points=points,
        colors=None if colors is None else colors[row, place],
        pose_error_deg=None if errors is None else float(errors[row, place]),
        mesh=mesh,
        surface=surface,
        signals={
            name: SignalImages(
                seen.targets[name], image, seen.mask, seen.rendered["silhouette"]
            )
            for name, image in seen.rendered.items()
        },
        group=group,
        chamfer=_find_chamfer(result, row, place),
        overlap=overlap,
        neighbours=()
        if shapes is None or surface is None
        else shapes.list_neighbours(surface, len(points)),
    )


def _find_chamfer(result, row, place) -> float | None:
    """The Chamfer distance of a view (times 100), where it was measured."""
    if result.chamfers is None or place >= result.chamfers.shape[1]:
        return None
    return 100 * float(result.chamfers[row, place].sum())


def list_view_poses(
    predictions: Predictions,
    dataset: DataSet,
    alignment: Alignment,
    result: Scores,
    failures: Failures | None,
) -> ViewPoses | None:
    """Azimuths of all test views; None where poses are not predicted or not known."""
    poses, _ = arrange_truth(dataset)
    if poses is None or failures is None or result.pose_errors_deg is None:
        return None
    found = align_poses(alignment, predictions.poses)
    return ViewPoses(
        true_deg=_list_azimuths(poses),
        predicted_deg=_list_azimuths(found),
        errors_deg=np.asarray(result.pose_errors_deg).ravel(),
        kinds=failures.kinds.ravel(),
    )


def _list_azimuths(poses) -> np.ndarray:
    return np.array([view_angles(pose)[0] for pose in np.reshape(poses, (-1, 4))])
