"""A finished run judged once more: on objects that it has not seen, on photographs.

By the split "final" nothing is chosen; photographs show the test objects, disturbed.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config.checks import SOURCES
from dpc_jax.data import DataSet, DataSpec
from dpc_jax.data.arrays import Stack
from dpc_jax.data.disturbances import DISTURBANCES
from dpc_jax.data.sets import framing
from dpc_jax.data.splits import FINAL
from dpc_jax.evaluation import scores
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.evaluation.surfaces import SAMPLES, draw_points
from dpc_jax.evaluation.wrapping import wrap_points
from dpc_jax.files import write_json
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.run.learner import Learner
from dpc_jax.run.prediction import check_ability
from dpc_jax.run.report.shown_views import Judged
from dpc_jax.run.report.summary import judge, list_metrics, measure_gains
from dpc_jax.run.report.training_shapes import TrainingShapes
from dpc_jax.run.setup import load_set, load_sets, make_data_specs
from dpc_jax.run.trained import TrainedNetwork, load_split, load_trained
from dpc_jax.run.workdir import read_config, read_metrics

_FINER = 2  # times the network's images: photographs are cut out and made smaller


def judge_finally(
    workdir: Path, meshes: Path | None = None, *, cache_dir: str = ""
) -> dict[str, Any]:
    """Metrics of a finished run on the split "final"; printed, kept in WORKDIR.

    The objects are procedural shapes of seeds that no other split has, as many as the
    test split has, or all meshes of a folder of another source, which must be given
    where the run's objects are not procedural.
    """
    trained = load_trained(workdir, cache_dir=cache_dir)
    config = trained.config
    spec = _specify(make_data_specs(config)["test"], config, meshes)
    dataset = load_set(config, spec)
    sets = load_sets(config) | {FINAL: dataset}
    learner = Learner(config, sets)
    threshold = (read_metrics(workdir) or {}).get("surface_threshold")
    predictions, _ = learner.predict(trained.state, FINAL, threshold=threshold)
    judged = judge(dataset, config, predictions, trained.alignment, threshold)
    count = predictions.points.shape[2]
    shapes = TrainingShapes.gather(sets | {"test": dataset}, count)
    metrics = list_metrics(judged, config, shapes)
    of_surfaces = _judge_surfaces(judged, sets | {"test": dataset})
    metrics |= {f"surface_{name}": value for name, value in of_surfaces.items()}
    metrics["objects"] = len(dataset.names)
    metrics["source"] = str(meshes) if meshes else "procedural"
    path = write_json(workdir / "final.json", metrics)
    print(f"Final: {describe_metrics(metrics)}, on {len(dataset.names)} objects.")
    if of_surfaces:
        print(f"Of their surfaces: {describe_metrics(of_surfaces)}.")
    print(f"Record: {path}")
    return metrics


def _judge_surfaces(judged: Judged, sets) -> dict[str, Any]:
    """Chamfer distances of the surfaces about the clouds of each object's first view.

    Clouds differ in how many points they have and in how even these are; of a surface
    `SAMPLES` points are compared, and of the references as many.
    """
    shapes = TrainingShapes.gather(sets, SAMPLES)
    if shapes is None:
        return {}
    predictions, dataset, alignment = judged[:3]
    poses, surfaces, visible = evaluator.arrange_truth(dataset)
    clouds = [draw_points(*wrap_points(cloud)) for cloud in predictions.points[:, 0]]
    wrapped = predictions._replace(points=np.stack(clouds)[:, None])
    known = {"alignment": alignment, "visible": visible}
    metrics = scores.score(None, poses, wrapped.points, surfaces, **known).metrics
    metrics |= shapes.measure_references(wrapped, dataset, alignment)
    return metrics | measure_gains(metrics)


def _specify(test: DataSpec, config, meshes: Path | None) -> DataSpec:
    """The specification of the objects, otherwise that of the test split."""
    if meshes is not None:
        return dataclasses.replace(
            test,
            kind="meshes",
            folder=str(meshes),
            fractions=(0, 0, 1),
            models=None,
            fold=None,
        )
    if any(getattr(config.data, name) for name in SOURCES):
        raise ValueError(
            "Expected meshes that the run has not seen, but --final_meshes was not "
            "given and its objects are not procedural; name a folder of meshes of "
            "another source with --final_meshes=DIR."
        )
    return dataclasses.replace(test, split=FINAL, models=config.data.test_models)


def judge_photographs(
    workdir: Path, *, cache_dir: str = ""
) -> dict[str, dict[str, float]]:
    """Metrics of a finished run on its test views, as they are and as photographs.

    Photographs are framed by their masks; their distance is not known. They are taken
    of the same objects from the same sides, undisturbed ("photographs") and with each
    of `DISTURBANCES` alone. Printed, and kept in WORKDIR/photographs.json.
    """
    check_ability(read_config(workdir), "--photographs")
    trained = load_trained(workdir, cache_dir=cache_dir)
    network, config = trained.network, trained.config
    predictor = make_predictor(network, config)
    found = {"renders": _measure(load_split(trained, "test"), trained, predictor)}
    spec = make_data_specs(config)["test"]
    side = _FINER * spec.image_size
    fine = load_split(trained, "test", image_size=side, visible_points=0)
    takes = {"photographs": lambda *view: view[:2]} | dict(DISTURBANCES)
    predictor = make_predictor(network, config, knows_distance=False)
    # Where distances are not known, silhouettes have sizes of their own.
    unknown = {"silhouette_iou", "projection_error"}
    for name, disturb in takes.items():
        taken = _take_photographs(fine, disturb, spec)
        metrics = _measure(taken, trained, predictor)
        found[name] = {n: v for n, v in metrics.items() if n not in unknown}
    for name, metrics in found.items():
        print(f"{name.capitalize()}: {describe_metrics(metrics)}.")
    print(f"Record: {write_json(workdir / 'photographs.json', found)}")
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


def _measure(dataset: DataSet, trained: TrainedNetwork, predictor) -> dict[str, float]:
    alignment = trained.alignment
    predictions = predict_all(predictor, trained.state, dataset)
    found = evaluator.score(
        predictions, dataset, alignment=alignment, has_visible=False
    )
    return found.metrics | scores.estimate_errors(found)
