"""Objects refined with all their views: what goes in, and what that is worth."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.scores import score
from dpc_jax.learning.inference.evaluator import arrange_truth
from dpc_jax.learning.inference.predictor import Predictions, arrange_views
from dpc_jax.learning.inference.refiner import Evidence, make_refiner
from dpc_jax.networks import ShapePoseNetwork

OBJECTS_AT_ONCE = 16
COMPONENTS = 64  # directions in which codes differ that are told apart
_MEASURED = (
    *("pose_accuracy", "pose_median_error_deg", "flip_share"),
    *("chamfer", "precision", "coverage"),
)


def join_views(
    found: Predictions, masks: np.ndarray, groups: Sequence[np.ndarray]
) -> Evidence:
    """What objects are fitted to.

    Args:
      found: predictions with their evidence, whose views are numbered row by row.
      masks: [n, S, S] of all views.
      groups: the views of each object. Objects with fewer views than others have their
        last one repeated, without weight.
    """
    width = 1 << (max(map(len, groups)) - 1).bit_length()
    rows = np.stack([g[np.minimum(np.arange(width), len(g) - 1)] for g in groups])
    flat: Any = jax.tree.map(lambda array: array.reshape(-1, *array.shape[2:]), found)
    cameras = {"translation": flat.translations, "focal_length": flat.focal_lengths}
    return Evidence(
        codes=np.stack([flat.codes[group].mean(axis=0) for group in groups]),
        poses=flat.poses[rows],
        candidates=flat.candidates[rows],
        probabilities=flat.probabilities[rows],
        masks=masks[rows],
        weights=np.stack([np.arange(width) < len(g) for g in groups]).astype("f4"),
        cameras={name: a[rows] for name, a in cameras.items() if a is not None},
    )


def find_directions(codes: np.ndarray) -> np.ndarray:
    """Directions [k, F] in which codes [..., F] vary, as long as their deviations.

    The principal axes, `COMPONENTS` at most: a sum of them with normal weights is as
    far from the mean as codes usually are.

    Raises:
      ValueError: for fewer than two codes, which do not vary.
    """
    codes = np.asarray(codes, np.float64).reshape(-1, codes.shape[-1])
    if len(codes) < 2:
        raise ValueError(
            f"Expected at least two views to measure how codes vary, but got "
            f"{len(codes)}; use a run with more validation images."
        )
    away = codes - np.mean(codes, axis=0)
    _, sizes, axes = np.linalg.svd(away, full_matrices=False)
    deviations = sizes / np.sqrt(len(codes) - 1)
    return (deviations[:, None] * axes)[:COMPONENTS].astype(np.float32)


def refine_objects(
    refiner: Callable,
    state: NamedTuple,
    evidence: Evidence,
    directions: np.ndarray,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, np.ndarray]]:
    """The n objects of the evidence, each with what `make_refiner` says of its views.

    `OBJECTS_AT_ONCE` at a time; the last ones are repeated.
    """
    total, parts = len(evidence.codes), []
    at_once = min(OBJECTS_AT_ONCE, 1 << (total - 1).bit_length())
    for start in range(0, total, at_once):
        rows = np.minimum(np.arange(start, start + at_once), total - 1)
        batch = jax.tree.map(lambda array, rows=rows: np.asarray(array)[rows], evidence)
        parts.append(jax.device_get(refiner(state, batch, directions)))
        if on_progress:
            on_progress(min(start + at_once, total), total)
    arrays = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
    objects = []
    for i, weights in enumerate(evidence.weights):
        one, count = {name: a[i] for name, a in arrays.items()}, int(weights.sum())
        views = {name: one[name][:count] for name in ("poses", "silhouettes")}
        objects.append(one | views | {"errors": one["errors"][:, :count]})
    return objects


def measure_refinement(
    network: ShapePoseNetwork,
    config: Config,
    state: NamedTuple,
    test: DataSet,
    found: Predictions,
    *,
    validated: Predictions,
    alignment: Alignment,
) -> dict[str, Any]:
    """Figures of the test split with refinement, beside the plain ones.

    Their names begin with refined_ for each view on its own, joined_ for all views of
    an object together, and refined_joined_ for both; refine_seconds and
    refine_joined_seconds are for a view and for an object, compilation included.

    Args:
      found, validated: predictions of the test and validation splits, with their
        evidence.
    """
    assert validated.codes is not None
    directions = find_directions(validated.codes[..., : network.hidden])
    models, views = arrange_views(test)
    masks = np.asarray(test.masks[models.reshape(-1), views.reshape(-1)])
    every, refiner = np.arange(models.size), make_refiner(network, config)
    poses, surfaces = arrange_truth(test)

    def measure(groups, directions):
        begun = time.perf_counter()
        evidence = join_views(found, masks, groups)
        refined = refine_objects(refiner, state, evidence, directions)
        seconds = (time.perf_counter() - begun) / len(groups)
        clouds = np.stack([one["points"] for one in refined for _ in one["poses"]])
        result = score(
            np.concatenate([one["poses"] for one in refined]).reshape(*models.shape, 4),
            poses,
            clouds.reshape(*models.shape, *clouds.shape[1:]),
            surfaces,
            alignment=alignment,
        ).metrics
        errors = np.concatenate([one["errors"][1] for one in refined])
        kept = {n: result[n] for n in _MEASURED if n in result}
        return kept | {"silhouette_error": float(errors.mean())}, round(seconds, 2)

    figures: dict[str, Any] = {}
    alone, seconds = measure(list(every[:, None]), directions)
    figures |= {f"refined_{n}": v for n, v in alone.items()}
    figures["refine_seconds"] = seconds
    if models.shape[1] > 1:
        groups = list(every.reshape(models.shape))
        joined, _ = measure(groups, directions[:0])
        both, seconds = measure(groups, directions)
        figures |= {f"joined_{n}": v for n, v in joined.items()}
        figures |= {f"refined_joined_{n}": v for n, v in both.items()}
        figures["refine_joined_seconds"] = seconds
    return figures
