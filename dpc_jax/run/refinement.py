"""Several views of an object together, and refinement, with a run's network."""

import io
import time
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.evaluation.scores import score
from dpc_jax.files import read_bytes, write_bytes
from dpc_jax.learning.inference.codes import (
    Codes,
    encode_all,
    find_directions,
    make_coder,
)
from dpc_jax.learning.inference.evaluator import arrange_truth
from dpc_jax.learning.inference.explanation import FINALISTS
from dpc_jax.learning.inference.predictor import arrange_views
from dpc_jax.learning.inference.refinement import (
    Evidence,
    RefineSettings,
    make_refiner,
    refine_all,
)
from dpc_jax.learning.step import TrainState
from dpc_jax.networks import ShapePoseNetwork

_KEPT = Path("report") / "codes.npz"  # of a workdir: directions of codes
_MOST_KEPT = 2**28  # bytes of it
_MEASURED = ("pose_accuracy", "pose_median_error_deg", "flip_share", "chamfer")
_MEASURED = (*_MEASURED, "precision", "coverage")
_OWN = {"translations": "translation", "focal_lengths": "focal_length"}


class Refined(NamedTuple):
    """One object that all its views were asked for; in the network's frame.

    Attributes:
      points: [N, 3]. colors: [N, 3] or None. poses: [V, 4].
      silhouettes: [V, D, D], errors_before and errors: [V], see `make_refiner`.
    """

    points: np.ndarray
    colors: np.ndarray | None
    poses: np.ndarray
    silhouettes: np.ndarray
    errors_before: np.ndarray
    errors: np.ndarray


def read_directions(
    workdir: Path,
    coder: Callable,
    state: TrainState,
    load: Callable[[], DataSet],
    *,
    width: int,
) -> np.ndarray:
    """How codes of a run vary [k, F]; measured once and kept in its report folder.

    Args:
      coder: of `make_coder`. load: gives the validation split, which is asked for where
        nothing is kept that can be used. width: F.
    """
    path, step = workdir / _KEPT, int(state.step)
    kept = _read_kept(path, step)
    if kept is not None and kept.shape[1] == width:
        return kept
    directions = measure_directions(load(), coder, state)
    buffer = io.BytesIO()
    np.savez(buffer, step=step, directions=directions)
    path.parent.mkdir(exist_ok=True)
    write_bytes(path, buffer.getvalue())
    return directions


def _read_kept(path: Path, step: int) -> np.ndarray | None:
    """Directions kept of a step; None where there are none that can be used."""
    damages = (OSError, ValueError, KeyError, EOFError, TypeError)
    try:
        file = io.BytesIO(read_bytes(path, most=_MOST_KEPT))
        with np.load(file, allow_pickle=False) as kept:
            directions = kept["directions"]
            is_whole = directions.dtype == np.float32 and directions.ndim == 2
            is_whole = is_whole and bool(np.isfinite(directions).all())
            return directions if is_whole and int(kept["step"]) == step else None
    except (*damages, zipfile.BadZipFile, zlib.error):
        return None


def measure_directions(
    dataset: DataSet, coder: Callable, state: TrainState
) -> np.ndarray:
    """How the codes [n, F] of a set's views vary: directions [k, F]."""
    models, views = arrange_views(dataset)
    rows = models.reshape(-1), views.reshape(-1)
    found = encode_all(coder, state, dataset.images[rows], dataset.masks[rows])
    return find_directions(found.codes)


def join_views(
    found: Codes, masks: np.ndarray, groups: Sequence[np.ndarray]
) -> Evidence:
    """What objects are fitted to, from views [n, ...] that belong to them.

    Args:
      groups: the views of each object. Objects with fewer views than others have their
        last one repeated, without weight.
    """
    assert found.poses is not None and found.candidates is not None
    assert found.probabilities is not None
    width = 1 << (max(map(len, groups)) - 1).bit_length()
    rows = np.stack([g[np.minimum(np.arange(width), len(g) - 1)] for g in groups])
    codes = found.codes
    if found.tints is not None:
        codes = np.concatenate([codes, found.tints], axis=1)
    return Evidence(
        codes=np.stack([codes[group].mean(axis=0) for group in groups]),
        poses=found.poses[rows],
        candidates=found.candidates[rows],
        probabilities=found.probabilities[rows],
        masks=masks[rows],
        weights=np.stack([np.arange(width) < len(g) for g in groups]).astype("f4"),
        own={_OWN[name]: array[rows] for name, array in found.cameras.items()},
    )


def refine_objects(
    network: ShapePoseNetwork,
    config: Config,
    state: TrainState,
    evidence: Evidence,
    directions: np.ndarray | None,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Refined]:
    """Each object of the evidence, refined along directions; without, only joined.

    Views of one object have their poses chosen anew by the shape that they share, a
    single view has its own where predictions are chosen by the fit, and is refined from
    the likeliest few of them.
    """
    has_several = evidence.poses.shape[1] > 1
    weighs_one = config.pose.weighs_fit and not has_several
    settings = RefineSettings(
        steps=0 if directions is None else RefineSettings.steps,
        is_rechosen=has_several or weighs_one,
        hypotheses=FINALISTS if weighs_one and directions is not None else 1,
    )
    if directions is None:
        directions = np.zeros((1, evidence.codes.shape[1]), np.float32)
    refiner = make_refiner(network, config, settings)  # pyright: ignore
    arrays = refine_all(refiner, state, evidence, directions, on_progress=on_progress)
    counts = evidence.weights.sum(axis=1).astype(int)
    colors = arrays.get("colors", [None] * len(counts))
    return [
        Refined(
            arrays["points"][i],
            colors[i],
            *(
                arrays[name][i][:count]
                for name in ("poses", "silhouettes", "errors_before", "errors")
            ),
        )
        for i, count in enumerate(counts)
    ]


def measure_refinement(
    network: ShapePoseNetwork,
    config: Config,
    state: TrainState,
    sets: dict[str, DataSet],
    alignment: Alignment,
) -> dict[str, Any]:
    """Figures of the test split with refinement, beside the plain ones.

    Their names begin with refined_ for each view on its own, joined_ for all views of
    an object together, and refined_joined_ for both; refine_seconds and
    refine_joined_seconds are for a view and for an object, compilation included.
    """
    coder, test = make_coder(network, config), sets["test"]
    directions = measure_directions(sets["val"], coder, state)
    models, views = arrange_views(test)
    rows = models.reshape(-1), views.reshape(-1)
    found = encode_all(coder, state, test.images[rows], test.masks[rows])
    masks, every = np.asarray(test.masks[rows]), np.arange(len(rows[0]))
    poses, surfaces = arrange_truth(test)

    def measure(groups, directions):
        begun = time.perf_counter()
        evidence = join_views(found, masks, groups)
        refined = refine_objects(network, config, state, evidence, directions)
        seconds = (time.perf_counter() - begun) / len(groups)
        clouds = np.stack([one.points for one in refined for _ in one.poses])
        result = score(
            np.concatenate([one.poses for one in refined]).reshape(*models.shape, 4),
            poses,
            clouds.reshape(*models.shape, *clouds.shape[1:]),
            surfaces,
            alignment=alignment,
        ).metrics
        errors = np.concatenate([one.errors for one in refined])
        kept = {n: result[n] for n in _MEASURED if n in result}
        return kept | {"silhouette_error": float(errors.mean())}, seconds

    figures: dict[str, Any] = {}
    alone, seconds = measure([every[i : i + 1] for i in every], directions)
    figures |= {f"refined_{n}": v for n, v in alone.items()}
    figures["refine_seconds"] = round(seconds, 2)
    if models.shape[1] > 1:
        groups = list(every.reshape(models.shape))
        joined, _ = measure(groups, None)
        both, seconds = measure(groups, directions)
        figures |= {f"joined_{n}": v for n, v in joined.items()}
        figures |= {f"refined_joined_{n}": v for n, v in both.items()}
        figures["refine_joined_seconds"] = round(seconds, 2)
    return figures
