"""A finished run on its test views as photographs show them, each disturbance alone."""

import dataclasses
from pathlib import Path

import numpy as np

from dpc_jax.data import DataSet, DataSpec
from dpc_jax.data.arrays import Stack
from dpc_jax.data.disturbances import DISTURBANCES
from dpc_jax.data.sets import framing
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.evaluation.scores import estimate_errors
from dpc_jax.files import write_json
from dpc_jax.learning.inference.evaluator import score
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.run.prediction import check_ability
from dpc_jax.run.setup import make_data_specs
from dpc_jax.run.trained import TrainedNetwork, load_split, load_trained
from dpc_jax.run.workdir import read_config

RECORD = "photographs.json"
_FINER = 2  # times the network's images: photographs are cut out and made smaller


def judge_photographs(
    workdir: Path, *, cache_dir: str = ""
) -> dict[str, dict[str, float]]:
    """Metrics of a finished run on its test views, as they are and as photographs.

    Photographs are framed by their masks; their distance is not known. They are taken
    of the same objects from the same sides, undisturbed ("photographs") and with each
    of `DISTURBANCES` alone. Printed, and kept in WORKDIR/photographs.json.

    Args:
      cache_dir: of rendered sets; that of the run where it is empty.
    """
    check_ability(read_config(workdir), "--photographs")
    trained = load_trained(workdir, cache_dir=cache_dir)
    found = {"renders": _measure(load_split(trained, "test"), trained)}
    spec = make_data_specs(trained.config)["test"]
    side = _FINER * spec.image_size
    fine = load_split(trained, "test", image_size=side, visible_points=0)
    takes = {"photographs": lambda *view: view[:2]} | dict(DISTURBANCES)
    for name, disturb in takes.items():
        taken = _take_photographs(fine, disturb, spec)
        found[name] = _measure(taken, trained, knows_distance=False)
    for name, metrics in found.items():
        print(f"{name.capitalize()}: {describe_metrics(metrics)}.")
    print(f"Record: {write_json(workdir / RECORD, found)}")
    return found


def _take_photographs(fine: DataSet, disturb, spec: DataSpec) -> DataSet:
    """Every view disturbed, then cut out by its mask, in the network's size."""
    spec = dataclasses.replace(spec, crop="view")
    images, masks = [], []
    for model in range(len(fine.names)):
        given = fine.rows("images", model), fine.rows("masks", model)
        views = [
            disturb(*pair, np.random.default_rng((model, view)))
            for view, pair in enumerate(zip(*given, strict=True))
        ]
        outlines = [framing.trace_outline(mask > 127) for _, mask in views]
        pairs = [(image, mask / np.float32(255)) for image, mask in views]
        frames = framing.frame_views(outlines, None, spec)
        cut = framing.cut_frames(pairs, frames, spec)
        images.append(cut["images"])
        masks.append(cut["masks"])
    return fine._replace(images=Stack(images), masks=Stack(masks), depths=None)


def _measure(dataset: DataSet, trained: TrainedNetwork, *, knows_distance=True):
    config, alignment = trained.config, trained.alignment
    predictor = make_predictor(trained.network, config, knows_distance=knows_distance)
    predictions = predict_all(predictor, trained.state, dataset, frame=alignment)
    scores = score(predictions, dataset, alignment=alignment, has_visible=False)
    metrics = scores.metrics | estimate_errors(scores)
    # Where distances are not known, silhouettes have sizes of their own.
    left_out = {} if knows_distance else {"silhouette_iou", "projection_error"}
    return {n: v for n, v in metrics.items() if n not in left_out}
