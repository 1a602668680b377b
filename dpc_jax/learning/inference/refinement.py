"""Objects refined with all their views: what goes in, and in which portions."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.inference.refiner import Evidence

OBJECTS_AT_ONCE = 16
COMPONENTS = 64  # directions in which codes differ that are told apart


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
