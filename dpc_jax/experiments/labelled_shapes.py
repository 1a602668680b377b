"""Test shapes of a finished run whose parts are known: the procedural ones."""

from typing import NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.data.sources import open_source
from dpc_jax.data.views import sample_faces
from dpc_jax.evaluation.correspondences import label_points
from dpc_jax.run.finished import FinishedRun, load_split, predict_points
from dpc_jax.run.setup import make_data_specs
from dpc_jax.shapes.building_blocks import read_labels
from dpc_jax.shapes.keypoints import KEYPOINTS, find_keypoints
from dpc_jax.shapes.procedural import make_shape

SURFACE_POINTS = 20_000  # of a shape: 0.01 apart, thinner than a leg


class LabelledShapes(NamedTuple):
    """Shapes of a split, their keypoints, and what a run predicts of them.

    Attributes:
      images: uint8 [n, S, S, 3], the first view of each shape.
      clouds: [n, N, 3] predicted from it, in the object frame.
      seeds: of the procedural shapes, n of them.
      keypoints: [n, K, 3] true ones; NaN where a shape has none.
      category: of all of them.
    """

    images: np.ndarray
    clouds: np.ndarray
    seeds: list[int]
    keypoints: np.ndarray
    category: str


def name_keypoints(run: FinishedRun) -> dict[str, str]:
    """The keypoints of a run's category by name, each with the label of its part.

    Raises:
      ValueError: where the run's shapes come without known parts.
    """
    category = run.config.category
    specs = make_data_specs(run.config)
    if category not in KEYPOINTS or any(s.folder for s in specs.values()):
        raise ValueError(
            f"Expected a run on procedural shapes ({', '.join(KEYPOINTS)}), whose "
            f"parts are known, but this one has category {category!r} from other "
            "data; give the workdir of a run of configs/chair.py."
        )
    return {name: label for name, (label, _) in KEYPOINTS[category].items()}


def read_shapes(run: FinishedRun, split: str) -> LabelledShapes:
    """The shapes of the split "val" or "test" with a run's predictions.

    Raises:
      ValueError: as `name_keypoints`, or where the split cannot be used.
    """
    names = name_keypoints(run)
    dataset = load_split(run, split)
    models = open_source(make_data_specs(run.config)[split]).list_models()
    known = {model.name: model.seed for model in models}
    seeds = [known[name] for name in dataset.names]
    (images, masks), category = read_first_views(dataset), run.config.category
    keypoints = np.array([_place_keypoints(category, s, names) for s in seeds])
    clouds = predict_points(run, images, masks)
    return LabelledShapes(images, clouds, seeds, keypoints, category)


def keep_complete(shapes: LabelledShapes) -> LabelledShapes:
    """The shapes that have all keypoints."""
    rows = np.flatnonzero(np.isfinite(shapes.keypoints).all(axis=(1, 2)))
    return shapes._replace(
        images=shapes.images[rows],
        clouds=shapes.clouds[rows],
        seeds=[shapes.seeds[row] for row in rows],
        keypoints=shapes.keypoints[rows],
    )


def read_first_views(dataset: DataSet) -> tuple[np.ndarray, np.ndarray]:
    """Images uint8 [n, S, S, 3] and masks [n, S, S]: the first view of every model."""
    models = np.arange(len(dataset.names))
    rows = models, np.zeros_like(models)
    return np.asarray(dataset.images[rows]), np.asarray(dataset.masks[rows])


def _place_keypoints(category, seed, names):
    found = find_keypoints(category, seed)
    missing = np.full(3, np.nan)
    return np.array([found[n].position if n in found else missing for n in names])


def label_cloud(cloud: np.ndarray, category: str, seed: int) -> np.ndarray:
    """The label [N] of the true part that is nearest to each point of a cloud.

    Args:
      cloud: [N, 3], of the shape that `make_shape` makes of category and seed.
    """
    mesh = make_shape(category, seed)
    surface, faces = sample_faces(mesh, count=SURFACE_POINTS)
    return label_points(cloud, surface, read_labels(mesh)[faces])


def label_shapes(shapes: LabelledShapes) -> list[np.ndarray]:
    """For each shape the label [N] of the true part nearest to each predicted point."""
    return [
        label_cloud(cloud, shapes.category, seed)
        for cloud, seed in zip(shapes.clouds, shapes.seeds, strict=True)
    ]
