"""What the last checkpoint of a run makes of photographs."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet
from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.evaluation.alignment import Alignment, align_points, align_poses
from dpc_jax.evaluation.confidence import Confidence, measure_confidence
from dpc_jax.evaluation.images import resize
from dpc_jax.learning import framing
from dpc_jax.learning.inference.predictor import (
    VIEWS_AT_ONCE,
    Predictions,
    make_predictor,
    predict_all,
)
from dpc_jax.learning.signals import spread_masks
from dpc_jax.run.prediction import PredictRequest, knows_distance, make_spec
from dpc_jax.run.prediction.still_objects import agree_on_pose, turn_to_cameras
from dpc_jax.run.process import prepare_process
from dpc_jax.run.trained import TrainedNetwork, load_checkpoint, load_split
from dpc_jax.run.workdir import read_alignment, read_config, read_metrics


class PredictedObject(NamedTuple):
    """An object as predicted, in the frame of the data where that is known."""

    photographs: Photographs  # its views
    rows: np.ndarray  # of predictions, that these are
    points: np.ndarray  # [N, 3]
    colors: np.ndarray | None  # [N, 3]
    poses: np.ndarray | None  # [V, 4]; None where the run predicts none
    silhouettes: np.ndarray  # [V, D, D]
    cameras: list[dict[str, Any]]  # what the run has learned of each view, by name
    # Vertices and faces of a surface that a voxel model predicts.
    mesh: tuple[np.ndarray, ...] | None = None
    is_aligned: bool = False  # whether the frame is that of the data
    confidences: list[Confidence] | None = None  # of views; None without an ensemble
    # [2, V] of silhouettes before and after refinement, per pixel.
    errors: np.ndarray | None = None
    seconds: float | None = None  # that its refinement took, compilation shared out


def predict_objects(
    found: list[Photographs], request: PredictRequest
) -> list[PredictedObject]:
    """Predict all objects; several views of one together.

    Validation images for refinement are kept in the folder `data`, or in the workdir:
    the workdir may be a stranger's, and its config names folders that are not.
    """
    workdir = request.workdir
    # All devices of this machine share the views.
    here: dict = {"run": {"devices": 0}, "train": {"models_per_batch": VIEWS_AT_ONCE}}
    here["data"] = {"cache_dir": str(request.data or workdir / "data")}
    config = replace_fields(read_config(workdir), here)
    prepare_process(VIEWS_AT_ONCE)
    alignment = read_alignment(workdir)
    run = load_checkpoint(config, workdir)
    is_known = knows_distance(config, make_spec(config, request.crop).crop)
    predictor = make_predictor(run.network, config, knows_distance=is_known)
    dataset = make_dataset(found)
    predictions = predict_all(predictor, run.state, dataset)
    if not (is_known or config.pose.known):
        found = place_photographs(found, predictions.silhouettes[:, 0])
    predicted = _list_objects(found, predictions, run, workdir)
    if request.is_refined or len(predicted) < len(dataset.names):
        if request.is_refined:
            directions = _measure_directions(run)
            masks = np.concatenate([one.fine_masks for one in found])
        else:
            directions = np.zeros((0, run.network.encoder.hidden), np.float32)
            masks = np.concatenate([one.masks for one in found])
        _join_and_refine(predicted, predictions, masks, run, directions)
    for place, one in enumerate(predicted):
        if config.pose.learned_heads > 1:
            one = one._replace(confidences=_judge(one, predictions, config))
        if config.pose.known:
            one = one._replace(poses=None)
        predicted[place] = _place(one, alignment)
    return predicted


def make_dataset(found: list[Photographs]) -> DataSet:
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


def place_photographs(
    found: Sequence[Photographs], silhouettes: np.ndarray
) -> list[Photographs]:
    """Photographs as the run's camera would have taken them.

    Their distance is not known: they are moved and scaled until the moments of a mask
    are those of the silhouette that is predicted of it.

    Args:
      silhouettes: [n, D, D] of all views, one object's after the other's.
    """
    ends = np.cumsum([len(one.sources) for one in found])[:-1]
    placed = []
    for one, seen in zip(found, np.split(silhouettes, ends), strict=True):
        given = framing.frame_by_moments(one.fine_masks / 255.0)
        place = framing.find_place(given, framing.frame_by_moments(seen))
        # Beyond an image is white, and nothing of the object.
        images = 255.0 - framing.cut_out(255.0 - one.images, place)
        masks, fine = (
            framing.cut_silhouettes(1.0 * array, place)
            for array in (one.masks, one.fine_masks)
        )
        images, masks, fine = (
            np.rint(array).astype(np.uint8) for array in (images, masks, fine)
        )
        placed.append(one._replace(images=images, masks=masks, fine_masks=fine))
    return placed


def _list_objects(
    found: list[Photographs],
    predictions: Predictions,
    run: TrainedNetwork,
    workdir: Path,
) -> list[PredictedObject]:
    """Objects as predicted from their first view, in the network's frame."""
    meshes: dict[int, Any] = {}
    ends = np.cumsum([len(one.sources) for one in found])
    groups = np.split(np.arange(ends[-1]), ends[:-1])
    if predictions.cells is not None:
        # They need libraries of their own.
        from dpc_jax.learning.inference import volumes

        # A finished run has tuned it.
        metrics = read_metrics(workdir) or {}
        threshold = metrics.get("surface_threshold") or volumes.FIRST_THRESHOLD
        predictions = volumes.add_points(predictions, threshold)
        meshes = {
            row: volumes.find_surface(predictions, row, threshold, run.alignment)
            for row, *_ in groups
        }
    colors = predictions.colors
    cameras = {  # in the camera frame, box diagonals; of an image 1 wide
        "translation": predictions.translations,
        "focal_length": predictions.focal_lengths,
    }
    learned = {name: a for name, a in cameras.items() if a is not None}
    return [
        PredictedObject(
            photographs=one,
            rows=rows,
            points=predictions.points[rows[0], 0],
            colors=None if colors is None else colors[rows[0], 0],
            poses=predictions.poses[rows, 0],
            silhouettes=predictions.silhouettes[rows, 0],
            cameras=[{n: a[i, 0].tolist() for n, a in learned.items()} for i in rows],
            mesh=meshes.get(rows[0]),
        )
        for one, rows in zip(found, groups, strict=True)
    ]


def _measure_directions(run: TrainedNetwork) -> np.ndarray:
    """How codes vary [k, width] in validation images, framed as those of training."""
    from dpc_jax.learning.inference.refiner import find_directions  # where asked for

    predictor = make_predictor(run.network, run.config)
    validated = predict_all(predictor, run.state, load_split(run, "val"))
    return find_directions(validated.codes[..., : run.network.encoder.hidden])


def _join_and_refine(
    predicted: list[PredictedObject],
    predictions: Predictions,
    masks: np.ndarray,
    run: TrainedNetwork,
    directions: np.ndarray,
):
    """Put in what several views say together, and what refinement finds."""
    from dpc_jax.learning.inference import refiner  # only where asked for

    config, is_refined = run.config, len(directions) > 0
    if is_refined:  # in the resolution of the masks
        fine = {"render": {"fine_grid": masks.shape[-1]}}
        config = replace_fields(config, fine)
    refine = refiner.make_refiner(run.network, config)
    predictions = _hold_still(predictions, predicted)
    widths: dict[int, list[int]] = {}  # of about as many views, together
    for place, one in enumerate(predicted):
        if is_refined or len(one.rows) > 1:
            widths.setdefault((len(one.rows) - 1).bit_length(), []).append(place)
    for places in widths.values():
        begun = time.perf_counter()
        groups = [predicted[place].rows for place in places]
        evidence = refiner.join_views(predictions, masks, groups)
        refined = refiner.refine_objects(
            refine, run.state, evidence, directions, on_progress=_tell
        )
        seconds = (time.perf_counter() - begun) / len(places)
        for place, found in zip(places, refined, strict=True):
            costs = {} if is_refined else {"errors": None}
            costs |= {"seconds": seconds if is_refined else None}
            predicted[place] = predicted[place]._replace(**(found | costs))


def _tell(done: int, total: int):
    if total > 1:
        print(f"Fitting to silhouettes: {done} of {total}", file=sys.stderr)


def _judge(one: Any, found: Any, config: Config) -> list[Confidence]:
    """The confidence in each view's pose, by masks as renders would show them."""
    side, given = one.silhouettes.shape[-1], one.photographs
    masks = given.masks if side <= given.masks.shape[-1] else given.fine_masks
    shown = [resize(mask / 255.0, side) for mask in masks]
    if config.spreads_masks:
        shown = list(spread_masks(jnp.asarray(shown)))
    views = zip(
        one.poses,
        found.candidates[one.rows, 0],
        found.probabilities[one.rows, 0],
        one.silhouettes,
        shown,
        strict=True,
    )
    return [measure_confidence(*view) for view in views]


def _hold_still(
    predictions: Predictions, predicted: list[PredictedObject]
) -> Predictions:
    """Predictions where objects before known cameras have one pose, as only candidate.

    It is that of the object in the world.
    """
    poses, candidates = map(np.array, (predictions.poses, predictions.candidates))
    chances = np.asarray(predictions.probabilities)
    for one in predicted:
        cameras, rows = one.photographs.cameras, (one.rows, 0)
        if cameras is not None:
            known = poses[rows], candidates[rows], chances[rows]
            poses[rows] = agree_on_pose(cameras, *known)
            candidates[rows] = poses[rows][:, None]
    return predictions._replace(poses=poses, candidates=candidates)


def _place(one: PredictedObject, alignment: Alignment | None) -> PredictedObject:
    """In the data's frame and the cameras of the photographs, where they are known."""
    points, poses, given = one.points, one.poses, one.photographs
    if alignment is not None:
        points = align_points(alignment, points)
        poses = None if poses is None else align_poses(alignment, poses)
    if not (poses is None or given.cameras is None or given.turns is None):
        poses = turn_to_cameras(poses, given.cameras, given.turns)
    is_aligned = alignment is not None
    return one._replace(points=points, poses=poses, is_aligned=is_aligned)
