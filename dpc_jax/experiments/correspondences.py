"""§ Discovery of semantic correspondences: keypoints transferred by point indices.

As in the paper, from two templates of the validation split to test shapes. Two things
differ: keypoints are not marked by hand but follow from how the procedural shapes are
made, and what the paper shows in pictures is also measured, over many template pairs.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.data.sources import open_source
from dpc_jax.data.views import sample_faces
from dpc_jax.evaluation import correspondences as transfers
from dpc_jax.reporting import keypoint_figures
from dpc_jax.run.finished import FinishedRun, load_split, predict_points, read_run
from dpc_jax.run.setup import make_data_specs
from dpc_jax.shapes.building_blocks import read_labels
from dpc_jax.shapes.keypoints import KEYPOINTS, find_keypoints
from dpc_jax.shapes.procedural import make_shape

RADIUS = 0.05  # of the box diagonal: what is near a keypoint (the paper: "small")
LEAST = 5  # points of a keypoint
PAIRS = 20  # of templates; the first is drawn
SHOWN = 16  # test shapes in the picture
SURFACE_POINTS = 20_000  # of a true shape: 0.01 apart, thinner than a leg
METHODS = {  # how the points of a keypoint are found in a shape, and what it is called
    "index": "same indices (the paper's way)",
    "random": "random indices",
    "place": "nearest to the templates' keypoint",
    "own": "nearest to the true keypoint",
}
MEASURES = {
    "right": "Points on the right part (share)",
    "distance": "Distance from the shape's own keypoint (box diagonals)",
    "follows": "How far points follow their keypoint (0: not, 1: all the way)",
}
Figures = list[tuple[Path, str]]  # with their captions


def run(out: Path, workdir: Path) -> tuple[dict[str, float], Figures]:
    """Transfer keypoints in a finished run, measure it and draw it.

    Args:
      out: folder of the figures.
      workdir: of a finished run on procedural shapes, with known poses or without.

    Returns:
      The measures of each of `METHODS`, and the figures.

    Raises:
      ValueError: where the workdir holds no such run, or too few of its validation
        shapes have all keypoints. OSError: where files cannot be written.
    """
    finished = read_run(Path(workdir))
    labels = name_keypoints(finished)
    templates = keep_complete(read_shapes(finished, "val"))
    shapes = read_shapes(finished, "test")
    pairs = draw_pairs(len(templates.seeds))
    found = measure_pairs(templates, shapes, pairs, list(labels.values()))
    measures = {
        f"{text}: {METHODS[method]}": getattr(values, name)
        for name, text in MEASURES.items()
        for method, values in found.items()
    }
    bars = {
        f"{METHODS[method]}: {100 * values.right:.0f} %": dict(
            zip(labels, values.right_by_keypoint, strict=True)
        )
        for method, values in found.items()
    }
    figures = [
        (
            _draw_pair(out / "correspondences.png", templates, shapes, pairs[0]),
            "Keypoints on two templates, and where points of the same index are on "
            "other shapes.",
        ),
        (
            keypoint_figures.draw_shares(bars, out / "correspondences_parts.png"),
            "Share of transferred points on the right part, by keypoint.",
        ),
    ]
    return measures, figures


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
    names, category = name_keypoints(run), run.config.category
    dataset = load_split(run, split)
    models = open_source(make_data_specs(run.config)[split]).list_models()
    known = {model.name: model.seed for model in models}
    seeds = [known[name] for name in dataset.names]
    images, masks = read_first_views(dataset)
    missing = np.full(3, np.nan)
    found = [find_keypoints(category, seed) for seed in seeds]
    keypoints = np.array(
        [[f[n].position if n in f else missing for n in names] for f in found]
    )
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
    rows = np.arange(len(dataset.names)), np.zeros(len(dataset.names), int)
    return np.asarray(dataset.images[rows]), np.asarray(dataset.masks[rows])


def label_shapes(shapes: LabelledShapes) -> list[np.ndarray]:
    """For each shape the label [N] of the true part nearest to each predicted point."""
    found = []
    for cloud, seed in zip(shapes.clouds, shapes.seeds, strict=True):
        mesh = make_shape(shapes.category, seed)
        surface, faces = sample_faces(mesh, count=SURFACE_POINTS)
        labels = read_labels(mesh)[faces]
        found.append(transfers.label_points(cloud, surface, labels))
    return found


def draw_pairs(count: int) -> np.ndarray:
    """Rows [PAIRS, 2] of different templates out of `count`, seed 0.

    Raises:
      ValueError: where there are fewer than two templates.
    """
    if count < 2:
        raise ValueError(
            "Expected at least 2 validation shapes with all keypoints, but there "
            f"are {count}; give a run with more --config.data.val_models."
        )
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, 2, replace=False) for _ in range(PAIRS)])


class Transferred(NamedTuple):
    """How well one of `METHODS` does, over all pairs and shapes.

    Attributes:
      right: share of points whose nearest true surface belongs to the keypoint's part.
      distance: to the shape's own keypoint, object units.
      follows: see `measure_following`.
      right_by_keypoint: K shares.
    """

    right: float
    distance: float
    follows: float
    right_by_keypoint: list[float]


class _Pair(NamedTuple):
    """Templates, and what is transferred from them.

    clouds: [T, N, 3]. keypoints: [T, K, 3]. places: [K, 3] their mean. found, random: K
    arrays of indices, of equal lengths.
    """

    clouds: np.ndarray
    keypoints: np.ndarray
    places: np.ndarray
    found: transfers.Indices
    random: transfers.Indices


def measure_pairs(
    templates: LabelledShapes,
    shapes: LabelledShapes,
    pairs: np.ndarray,
    labels: Sequence[str],
) -> Mapping[str, Transferred]:
    """Measures of the transfer from pairs of templates to all shapes, by method.

    Args:
      templates: validation shapes that have all keypoints. shapes: test shapes.
      pairs: [P, T] rows of templates.
      labels: of the parts of the K keypoints.
    """
    rng, near = np.random.default_rng(0), label_shapes(shapes)
    made = [_make_pair(templates, rows, rng) for rows in pairs]
    found = {}
    for method in METHODS:
        results = [_transfer(method, pair, shapes, near, labels) for pair in made]
        right, distance, follows = map(np.array, zip(*results, strict=True))
        found[method] = Transferred(
            float(np.nanmean(right)),
            float(np.nanmean(distance)),
            float(follows.mean()),
            [_mean(column) for column in np.moveaxis(right, -1, 0)],
        )
    return found


def _mean(values: np.ndarray) -> float:
    """Mean of what is known; NaN where nothing is, without a warning."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _make_pair(templates, rows, rng) -> _Pair:
    clouds, marks = templates.clouds[rows], templates.keypoints[rows]
    found = transfers.select_indices(clouds, marks, radius=RADIUS, least=LEAST)
    random = [rng.choice(clouds.shape[1], len(i), replace=False) for i in found]
    return _Pair(clouds, marks, marks.mean(axis=0), found, random)


def _choose(method, pair: _Pair, cloud, own) -> transfers.Indices:
    """The points of all keypoints in a cloud whose own keypoints are `own` [K, 3]."""
    if method in ("index", "random"):
        return pair.found if method == "index" else pair.random
    counts = [len(index) for index in pair.found]
    places = pair.places if method == "place" else own
    return transfers.select_nearest(cloud, places, counts)


def _transfer(method, pair: _Pair, shapes, point_labels, labels):
    """Shares and distances [S, K], and how the points follow, of one pair."""

    def measure(cloud, own, near):
        found = _choose(method, pair, cloud, own)
        return transfers.measure_transfer(
            cloud, found, point_labels=near, labels=labels, keypoints=own
        )

    # Where the points are in the templates; what they are near is not asked there.
    nothing = np.full(pair.clouds.shape[1], "")
    marked = zip(pair.clouds, pair.keypoints, strict=True)
    start = np.mean([measure(*item, nothing).centre for item in marked], axis=0)
    moved = [
        measure(*item)
        for item in zip(shapes.clouds, shapes.keypoints, point_labels, strict=True)
    ]
    moves = np.array([one.centre for one in moved]) - start
    follows = transfers.measure_following(moves, shapes.keypoints - pair.places)
    return [one.right for one in moved], [one.distance for one in moved], follows


def _draw_pair(path, templates, shapes, rows) -> Path:
    """The templates and some test shapes with the points of a pair in colours."""
    found = _make_pair(templates, rows, np.random.default_rng(0)).found
    count = min(SHOWN, len(shapes.seeds))
    shown = np.linspace(0, len(shapes.seeds) - 1, count).astype(int)
    return keypoint_figures.draw_transfers(
        np.concatenate([templates.images[rows], shapes.images[shown]]),
        np.concatenate([templates.clouds[rows], shapes.clouds[shown]]),
        found,
        path,
        templates=len(rows),
    )
