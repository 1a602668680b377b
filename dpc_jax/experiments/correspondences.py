"""§ Discovery of semantic correspondences: keypoints transferred by point indices.

The point of one output unit tends to be on the same part of every object. As in the
paper, keypoints are marked on two templates of the validation split, and the indices of
the predicted points near them, in both templates, are looked up in test shapes. Two
things differ: keypoints are not marked by hand but follow from how procedural chairs
are made, and what the paper shows in pictures is also measured, over many pairs.

A keypoint is the vertex of one part that lies farthest in a direction, in the object
frame (x front, y left, z up): the tip of the front left leg is where "leg" reaches
farthest forward, left and, above all, down.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.data import DataSet
from dpc_jax.data.sources import open_source
from dpc_jax.data.views import sample_surface
from dpc_jax.reporting import paper_figures
from dpc_jax.run.setup import make_data_specs
from dpc_jax.run.trained import TrainedNetwork, load_split, load_trained, predict_points
from dpc_jax.shapes.building_blocks import join
from dpc_jax.shapes.chairs import draw_plan, make_groups
from dpc_jax.shapes.procedural import make_shape, seed_stream

KEYPOINTS = {  # part, and direction
    f"{end} {side} {text}": (label, (x, y, up))
    for text, label, up in (("seat corner", "seat", 0.1), ("leg tip", "leg", -3))
    for end, x in (("front", 1), ("rear", -1))
    for side, y in (("left", 1), ("right", -1))
}
KEYPOINTS |= {"left back corner": ("back", (0, 1, 1))}
KEYPOINTS |= {"right back corner": ("back", (0, -1, 1))}
# What a chair stands on at four places. A star or a round foot has no leg tips.
_FOUR_FOOTED = ("legs", "sled", "block")
RADIUS = 0.05  # of the box diagonal: what is near a keypoint (the paper: "small")
LEAST = 5  # points of a keypoint
PAIRS = 20  # of templates; the first is drawn
SHOWN = 16  # test shapes in the picture
SURFACE_POINTS = 20_000  # of a true shape: 0.01 apart, thinner than a leg
METHODS = (  # how the points of a keypoint are found in a shape
    "same indices (the paper's way)",
    "random indices",
    "nearest to the templates' keypoint",
)
MEASURES = (
    "Points on the right part (share)",
    "How far points follow their keypoint (0: not, 1: all the way)",
)
Indices = Sequence[np.ndarray]  # for each of K keypoints the indices [n_k] of points


class LabelledShapes(NamedTuple):
    """Shapes of a split, their keypoints, and what a run predicts of them."""

    images: np.ndarray  # uint8 [n, S, S, 3], the first view of each shape
    clouds: np.ndarray  # [n, N, 3] predicted from it, in the object frame
    seeds: np.ndarray  # [n] of the procedural shapes
    keypoints: np.ndarray  # [n, K, 3] true ones; NaN where a shape has none


def run(out: Path, workdir: Path) -> tuple[dict[str, float], list[tuple[Path, str]]]:
    """Transfer keypoints in a finished run on procedural shapes; measure and draw it.

    Args:
      out: folder of the figures. workdir: of the run.

    Returns:
      The measures of each of `METHODS`, and the figures with their captions.
    """
    finished = load_trained(workdir)
    check_parts(finished)
    labels = [label for label, _ in KEYPOINTS.values()]
    templates, shapes = (read_shapes(finished, name) for name in ("val", "test"))
    has_all = np.isfinite(templates.keypoints).all(axis=(1, 2))
    templates = LabelledShapes(*(array[has_all] for array in templates))
    near = [
        label_points(cloud, seed)
        for cloud, seed in zip(shapes.clouds, shapes.seeds, strict=True)
    ]
    count, draw = len(templates.seeds), np.random.default_rng(0).choice
    rows = np.array([draw(count, 2, replace=False) for _ in range(PAIRS)])
    rng = np.random.default_rng(0)
    pairs = [_transfer(templates, row, rng, shapes, near, labels) for row in rows]
    values = np.mean([found for _, found in pairs], axis=0).tolist()
    measures = {
        f"{text}: {method}": found[place]
        for place, text in enumerate(MEASURES)
        for method, found in zip(METHODS, values, strict=True)
    }
    count = min(SHOWN, len(shapes.seeds))
    shown, first = np.linspace(0, len(shapes.seeds) - 1, count).astype(int), rows[0]
    path = paper_figures.draw_transfers(
        np.concatenate([templates.images[first], shapes.images[shown]]),
        np.concatenate([templates.clouds[first], shapes.clouds[shown]]),
        pairs[0][0],
        out / "correspondences.png",
        templates=len(first),
    )
    caption = "Keypoints on two templates, and where points of the same index are on "
    return measures, [(path, caption + "other shapes.")]


def check_parts(run: TrainedNetwork):
    """Raise ValueError where the parts of a run's shapes are not known."""
    if folder := make_data_specs(run.config)["val"].folder:
        raise ValueError(
            "Expected a run on procedural chairs, whose parts are known, but this one "
            f"has models of {folder}; leave --shapenet out."
        )


def find_keypoints(seed: int) -> dict[str, np.ndarray]:
    """Positions [3] of `KEYPOINTS` by name on the procedural chair of a seed.

    The leg tips of a chair that has none, such as a swivel chair, are left out.
    """
    mesh = make_shape("chair", seed)
    faces, vertices = np.asarray(mesh.faces), np.asarray(mesh.vertices)
    labels, found = label_faces(seed), {}
    has_tips = draw_plan(seed_stream("chair", seed)).base in _FOUR_FOOTED
    for name, (label, direction) in KEYPOINTS.items():
        if label != "leg" or has_tips:
            corners = vertices[np.unique(faces[labels == label])]
            found[name] = corners[np.argmax(corners @ np.asarray(direction, float))]
    return found


def read_shapes(run: TrainedNetwork, split: str) -> LabelledShapes:
    """The shapes of the split "val" or "test" with a run's predictions."""
    dataset = load_split(run, split)
    models = open_source(make_data_specs(run.config)[split]).list_models()
    known = {model.name: model.seed for model in models}
    seeds = np.array([known[name] for name in dataset.names])
    images, masks = read_first_views(dataset)
    missing = np.full(3, np.nan)
    found = [find_keypoints(int(seed)) for seed in seeds]
    keypoints = np.array([[f.get(n, missing) for n in KEYPOINTS] for f in found])
    return LabelledShapes(images, predict_points(run, images, masks), seeds, keypoints)


def read_first_views(dataset: DataSet) -> tuple[np.ndarray, np.ndarray]:
    """Images uint8 [n, S, S, 3] and masks [n, S, S]: the first view of every model."""
    rows = np.arange(len(dataset.names)), np.zeros(len(dataset.names), int)
    return np.asarray(dataset.images[rows]), np.asarray(dataset.masks[rows])


def label_points(cloud: np.ndarray, seed: int) -> np.ndarray:
    """The label [N] of the part of the true shape that is nearest to each point."""
    mesh = make_shape("chair", int(seed))
    surface, faces = sample_surface(mesh, count=SURFACE_POINTS)
    _, nearest = KDTree(surface).query(cloud)
    return label_faces(int(seed))[faces][nearest]


def label_faces(seed: int) -> np.ndarray:
    """What each face [F] of the procedural chair of a seed is a part of."""
    groups = make_groups(seed_stream("chair", seed))
    counts = [len(join(group).faces) if group else 0 for group in groups.values()]
    return np.repeat(list(groups), counts)


def _transfer(
    templates: LabelledShapes, rows, rng, shapes: LabelledShapes, point_labels, labels
) -> tuple[Indices, list[tuple[float, float]]]:
    """The indices of a pair of templates, and the measures of each of `METHODS`."""
    clouds, marks = templates.clouds[rows], templates.keypoints[rows]
    same = select_indices(clouds, marks, radius=RADIUS, least=LEAST)
    counts, places = [len(index) for index in same], marks.mean(axis=0)
    random = [rng.choice(clouds.shape[1], count, replace=False) for count in counts]

    def measure(find):
        def centre(cloud):
            return [cloud[index].mean(axis=0) for index in find(cloud)]

        right = [
            [np.mean(near[i] == part) for i, part in zip(find(c), labels, strict=True)]
            for c, near in zip(shapes.clouds, point_labels, strict=True)
        ]
        start = np.mean([centre(cloud) for cloud in clouds], axis=0)
        moves = np.array([centre(cloud) for cloud in shapes.clouds]) - start
        follows = measure_following(moves, shapes.keypoints - places)
        return float(np.mean(right)), follows

    methods = (
        lambda cloud: same,
        lambda cloud: random,
        lambda cloud: select_nearest(cloud, places, counts),
    )
    return same, [measure(find) for find in methods]


def select_indices(
    templates: ArrayLike, keypoints: ArrayLike, *, radius: float, least: int = 1
) -> list[np.ndarray]:
    """Indices of the points that are near a keypoint in every template.

    Args:
      templates: [T, N, 3] predicted clouds.
      keypoints: [T, K, 3] the keypoints of each template, in the same frame.
      radius: how near, in object units.
      least: points that a keypoint should have. Where fewer agree within the radius, it
        becomes the smallest one within which so many do.

    Returns:
      For each of the K keypoints the indices [n_k], rising, n_k at least `least`.
    """
    clouds, marks = np.asarray(templates, float), np.asarray(keypoints, float)
    # Near in every template is near in the one where a point is farthest.
    away = np.linalg.norm(clouds[:, None] - marks[:, :, None], axis=-1).max(axis=0)
    reach = np.maximum(radius, np.partition(away, least - 1, axis=-1)[:, least - 1])
    return [np.flatnonzero(row <= r) for row, r in zip(away, reach, strict=True)]


def select_nearest(
    cloud: ArrayLike, positions: ArrayLike, counts: Sequence[int]
) -> list[np.ndarray]:
    """For each position [K, 3] the indices of that many points of a cloud near it."""
    away = np.linalg.norm(np.asarray(cloud) - np.asarray(positions)[:, None], axis=-1)
    pairs = zip(away, counts, strict=True)
    return [np.argpartition(row, count - 1)[:count] for row, count in pairs]


def measure_following(moves: ArrayLike, true_moves: ArrayLike) -> float:
    """How far points move with their keypoint from template to shape: 1 as far, 0 not.

    It is the slope of the regression of the moves on the true moves [..., 3], without a
    constant. Moves with NaN are left out; NaN where nothing moves.
    """
    moves, truth = np.asarray(moves, float), np.asarray(true_moves, float)
    known = np.isfinite(moves + truth).all(axis=-1)
    length = np.sum(truth[known] ** 2)
    return float(np.sum(moves[known] * truth[known]) / length) if length > 0 else np.nan
