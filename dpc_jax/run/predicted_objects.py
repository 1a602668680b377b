"""What the last checkpoint of a run makes of photographs."""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet
from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.evaluation.alignment import (
    Alignment,
    align_points,
    align_poses,
    identity_alignment,
)
from dpc_jax.evaluation.confidence import Confidence, measure_confidence
from dpc_jax.evaluation.density import find_pairs, mix_pairs
from dpc_jax.evaluation.images import resize
from dpc_jax.learning.inference.predictor import (
    VIEWS_AT_ONCE,
    Predictions,
    make_predictor,
    predict_all,
)
from dpc_jax.run.finished import FinishedRun, load_split, restore_state
from dpc_jax.run.setup import make_network
from dpc_jax.run.workdir import read_alignment


class PredictedObject(NamedTuple):
    """An object as predicted, in the frame of the data where that is known.

    Attributes:
      photographs: its views.
      is_aligned: whether the frame is that of the data.
      points: [N, 3]. colors: [N, 3] or None. mesh: vertices and faces of a surface that
        a voxel model predicts, or None.
      poses: [V, 4], or None where the run predicts none.
      silhouettes: [V, D, D].
      confidences: of each view; None without an ensemble.
      cameras: of each view, what the run has learned of it by name.
      errors: [2, V] of silhouettes before and after refinement, per pixel, or None.
      seconds: that its refinement took, compilation shared out, or None.
    """

    photographs: Photographs
    is_aligned: bool
    points: np.ndarray
    colors: np.ndarray | None
    mesh: tuple[np.ndarray, ...] | None
    poses: np.ndarray | None
    silhouettes: np.ndarray
    confidences: list[Confidence] | None
    cameras: list[dict[str, Any]]
    errors: np.ndarray | None = None
    seconds: float | None = None


def predict_objects(
    found: list[Photographs],
    config: Config,
    workdir: Path,
    *,
    is_refined: bool,
    num_points: int = 0,
    data: Path | None = None,
) -> list[PredictedObject]:
    """Predict all objects; several views of one together.

    Clouds of fewer points than `num_points` are made denser, see `densify`. Validation
    images for refinement are kept in the folder `data`, or in the workdir: the workdir
    may be a stranger's, and its config names folders that are not.

    Raises:
      ValueError: where the checkpoints cannot be read, or refinement lacks the run's
        validation images.
    """
    # All devices of this machine share the views.
    here: dict = {"run": {"devices": 0}, "train": {"models_per_batch": VIEWS_AT_ONCE}}
    here["data"] = {"cache_dir": str(data or workdir / "data")}
    config = replace_fields(config, here)
    network = make_network(config)
    state = restore_state(config, workdir)
    alignment = read_alignment(workdir)
    has_ensemble = not config.pose.known and config.pose.heads > 1
    predictor = make_predictor(network, config, keeps_candidates=has_ensemble)
    dataset = _make_dataset(found)
    predictions = predict_all(predictor, state, dataset)
    counts = [len(one.sources) for one in found]
    groups = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    predictions, meshes = _find_surfaces(predictions, alignment, workdir)
    predicted = [
        _read_object(one, predictions, group)._replace(mesh=meshes[group[0]])
        for one, group in zip(found, groups, strict=True)
    ]
    if is_refined or max(counts) > 1:
        run = FinishedRun(config, network, state, alignment or identity_alignment())
        _join_and_refine(
            predicted, groups, dataset, run, workdir, is_refined=is_refined
        )
    return [
        _finish(one, num_points, None if config.pose.known else one.poses, alignment)
        for one in _judge_all(predicted, predictions, groups)
    ]


def _make_dataset(found: list[Photographs]) -> DataSet:
    """Every view as an object of its own."""
    return DataSet(
        images=np.concatenate([one.images for one in found])[:, None],
        masks=np.concatenate([one.masks for one in found])[:, None],
        depths=None,
        quaternions=None,
        surfaces=None,
        names=tuple(source for one in found for source in one.sources),
        skipped=(),
    )


def _find_surfaces(
    predictions: Predictions, alignment: Alignment | None, workdir: Path
) -> tuple[Predictions, list]:
    """Points and surfaces of voxel models; of others there are none."""
    rows = range(len(predictions.poses))
    if predictions.cells is None:
        return predictions, [None for _ in rows]
    # They need libraries of their own.
    from dpc_jax.learning.inference.volumes import add_points
    from dpc_jax.run import surfaces

    threshold = surfaces.read_threshold(workdir)
    predictions = add_points(predictions, threshold)
    frame = alignment or identity_alignment()
    found = [surfaces.find_surface(predictions, r, threshold, frame) for r in rows]
    return predictions, found


def _read_object(one: Photographs, predictions: Predictions, group) -> PredictedObject:
    """As predicted from its first view, in the network's frame."""
    colors = predictions.colors
    return PredictedObject(
        photographs=one,
        is_aligned=False,
        points=predictions.points[group[0], 0],
        colors=None if colors is None else colors[group[0], 0],
        mesh=None,
        poses=predictions.poses[group, 0],
        silhouettes=predictions.silhouettes[group, 0],
        confidences=None,
        cameras=[_describe_camera(predictions, row) for row in group],
    )


def _finish(
    one: PredictedObject, num_points: int, poses, alignment: Alignment | None
) -> PredictedObject:
    """With as many points as are asked for, in the data's frame where it is known."""
    points, colors = one.points, one.colors
    if num_points:
        pairs = find_pairs(points, num_points - len(points))
        points = np.concatenate([points, mix_pairs(points, pairs)])
        if colors is not None:
            colors = np.concatenate([colors, mix_pairs(colors, pairs)])
    if alignment is not None:
        points = align_points(alignment, points)
        poses = None if poses is None else align_poses(alignment, poses)
    is_aligned = alignment is not None
    return one._replace(
        points=points, colors=colors, poses=poses, is_aligned=is_aligned
    )


def _join_and_refine(
    predicted: list[PredictedObject],
    groups,
    dataset,
    run: FinishedRun,
    workdir: Path,
    *,
    is_refined: bool,
):
    """Put in what several views say together, and what refinement finds."""
    # Only where asked for.
    from dpc_jax.learning.inference.codes import encode_all, make_coder
    from dpc_jax.run import refinement

    network, config, state = run.network, run.config, run.state
    coder = make_coder(network, config)
    codes = encode_all(coder, state, dataset.images[:, 0], dataset.masks[:, 0])
    directions = None
    if is_refined:
        directions = refinement.read_directions(
            workdir,
            coder,
            state,
            lambda: load_split(run, "val"),
            width=codes.codes.shape[1],
        )
    widths = {}
    for place, group in enumerate(groups):
        if is_refined or len(group) > 1:
            widths.setdefault((len(group) - 1).bit_length(), []).append(place)
    for places in widths.values():
        begun = time.perf_counter()
        evidence = refinement.join_views(
            codes, dataset.masks[:, 0], [groups[place] for place in places]
        )
        refined = refinement.refine_objects(
            network, config, state, evidence, directions, on_progress=_tell
        )
        seconds = (time.perf_counter() - begun) / len(places)
        for place, one in zip(places, refined, strict=True):
            errors = np.stack([one.errors_before, one.errors])
            predicted[place] = predicted[place]._replace(
                points=one.points,
                colors=one.colors,
                poses=one.poses,
                silhouettes=one.silhouettes,
                errors=errors if is_refined else None,
                seconds=seconds if is_refined else None,
            )


def _tell(done: int, total: int):
    if total > 1:
        print(f"Fitting to silhouettes: {done} of {total}", file=sys.stderr)


def _judge_all(predicted, predictions: Predictions, groups) -> list[PredictedObject]:
    """With the confidence in each view's pose; as they are without candidates."""
    if predictions.candidates is None or predictions.probabilities is None:
        return predicted
    judged = []
    for one, group in zip(predicted, groups, strict=True):
        side = one.silhouettes.shape[-1]
        confidences = [
            measure_confidence(
                one.poses[i],
                predictions.candidates[row, 0],
                predictions.probabilities[row, 0],
                one.silhouettes[i],
                resize(one.photographs.masks[i] / 255.0, side),
            )
            for i, row in enumerate(group)
        ]
        judged.append(one._replace(confidences=confidences))
    return judged


def _describe_camera(predictions: Predictions, row: int) -> dict[str, Any]:
    """What NAME.json holds of the camera, where a run has learned it."""
    facts: dict[str, Any] = {}
    if predictions.translations is not None:  # in the camera frame, box diagonals
        facts["translation"] = predictions.translations[row, 0].tolist()
    if predictions.focal_lengths is not None:  # of an image 1 wide
        facts["focal_length"] = float(predictions.focal_lengths[row, 0])
    return facts
