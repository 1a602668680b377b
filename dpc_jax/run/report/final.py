"""A finished run on objects by which nothing was chosen: a test set of its own."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config.checks import SOURCES
from dpc_jax.data import DataSpec
from dpc_jax.data.splits import FINAL
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.evaluation.scores import score
from dpc_jax.evaluation.surfaces import SAMPLES, draw_points
from dpc_jax.evaluation.wrapping import wrap_points
from dpc_jax.files import write_json
from dpc_jax.learning.inference.evaluator import arrange_truth
from dpc_jax.learning.inference.predictor import arrange_views
from dpc_jax.run.learner import Learner
from dpc_jax.run.report.shown_views import Judged
from dpc_jax.run.report.summary import judge, list_metrics, measure_gains
from dpc_jax.run.report.training_shapes import TrainingShapes
from dpc_jax.run.setup import load_set, load_sets, make_data_specs
from dpc_jax.run.trained import load_trained
from dpc_jax.run.workdir import read_metrics

RECORD = "final.json"


def judge_finally(
    workdir: Path, meshes: Path | None = None, *, cache_dir: str = ""
) -> dict[str, Any]:
    """Metrics of a finished run on the split "final"; printed, kept in WORKDIR.

    The objects are procedural shapes of seeds that no other split has, as many as the
    test split has, or all meshes of a folder of another source.

    Args:
      meshes: of that folder; to be given where the run's objects are not procedural.
      cache_dir: of rendered sets; that of the run where it is empty.
    """
    trained = load_trained(workdir, cache_dir=cache_dir)
    config = trained.config
    spec = _specify(make_data_specs(config)["test"], config, meshes)
    dataset = load_set(config, spec)
    sets = load_sets(config) | {FINAL: dataset}
    learner = Learner(config, sets)
    threshold = (read_metrics(workdir) or {}).get("surface_threshold")
    predictions = learner.predict(
        trained.state, FINAL, frame=trained.alignment, threshold=threshold
    )
    judged = judge(predictions, dataset, config, trained.alignment, threshold)
    count = predictions.points.shape[2]
    shapes = TrainingShapes.gather(sets | {"test": dataset}, count)
    metrics = list_metrics(judged, config, shapes)
    of_surfaces = _judge_surfaces(judged, sets | {"test": dataset})
    metrics |= {f"surface_{name}": value for name, value in of_surfaces.items()}
    metrics["objects"] = len(dataset.names)
    metrics["source"] = str(meshes) if meshes else "procedural"
    path = write_json(workdir / RECORD, metrics)
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
    poses, surfaces = arrange_truth(dataset)
    models, _ = arrange_views(dataset)
    clouds = [draw_points(*wrap_points(cloud)) for cloud in predictions.points[:, 0]]
    wrapped = predictions._replace(points=np.stack(clouds)[:, None])
    visible = None
    if dataset.visible is not None:
        visible = map(dataset.read_visible, models[:, 0].tolist())
    known = {"alignment": alignment, "visible": visible}
    metrics = score(None, poses, wrapped.points, surfaces, **known).metrics
    metrics |= shapes.measure_references(wrapped, dataset, alignment)
    return metrics | measure_gains(metrics)


def _specify(test: DataSpec, config, meshes: Path | None) -> DataSpec:
    """The specification of the objects, otherwise that of the test split."""
    if meshes is not None:
        return dataclasses.replace(
            test,
            kind="meshes",
            folder=str(meshes),
            split="test",
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
