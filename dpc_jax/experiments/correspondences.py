"""§ Discovery of semantic correspondences: keypoints transferred by point indices.

As in the paper, from two templates of the validation split to test shapes. Two things
differ: keypoints are not marked by hand but follow from how the procedural shapes are
made, and what the paper shows in pictures is also measured, over many template pairs.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.evaluation import correspondences as transfers
from dpc_jax.experiments.labelled_shapes import (
    LabelledShapes,
    keep_complete,
    label_shapes,
    name_keypoints,
    read_shapes,
)
from dpc_jax.files import write_json
from dpc_jax.reporting import keypoint_figures
from dpc_jax.run.finished import read_run

RADIUS = 0.05  # of the box diagonal: what is near a keypoint (the paper: "small")
LEAST = 5  # points of a keypoint
PAIRS = 20  # of templates; the first is drawn
TEMPLATES = (1, 2, 3, 5)  # how many agree on the indices: the paper has 2
SHOWN = 16  # test shapes in the picture
METHODS = {  # how the points of a keypoint are found in a shape, and what it is called
    "index": "same indices (the paper's way)",
    "random": "random indices",
    "place": "nearest to the templates' keypoint",
    "own": "nearest to the true keypoint",
}


def run(out: Path | str, workdir: Path | str) -> tuple[dict[str, Any], list[Path]]:
    """Transfer keypoints in a finished run, measure it and draw it.

    Writes correspondences.json and the figures into `out`.

    Args:
      out: folder, made where there is none.
      workdir: of a finished run on procedural shapes, with known poses or without.

    Returns:
      The measures, see `measure_pairs`, with `by_templates`, the share on the right
      part with other numbers of templates; and the paths of the figures.

    Raises:
      ValueError: where the workdir holds no such run, or too few of its validation
        shapes have all keypoints. OSError: where files cannot be written.
    """
    out, finished = Path(out), read_run(Path(workdir))
    labels = name_keypoints(finished)
    templates = keep_complete(read_shapes(finished, "val"))
    shapes = read_shapes(finished, "test")
    pairs = draw_pairs(len(templates.seeds))
    near = label_shapes(shapes)
    metrics = measure_pairs(templates, shapes, pairs, labels=labels, point_labels=near)
    metrics["by_templates"] = {
        str(count): measure_pairs(
            templates,
            shapes,
            draw_pairs(len(templates.seeds), size=count),
            labels=labels,
            point_labels=near,
            methods=("index",),
        )["right_part"]
        for count in TEMPLATES
        if count <= len(templates.seeds)
    }
    write_json(out / "correspondences.json", metrics)
    bars = {
        f"{METHODS[method]}: {100 * values['right_part']:.0f} %": values[
            "right_part_by_keypoint"
        ]
        for method, values in metrics["by"].items()
    }
    figures = [
        _draw_pair(out / "correspondences.png", templates, shapes, pairs[0]),
        keypoint_figures.draw_shares(bars, out / "correspondences_parts.png"),
    ]
    return metrics, figures


def draw_pairs(count: int, *, size: int = 2, pairs: int = PAIRS) -> np.ndarray:
    """Rows [pairs, size] of different templates out of `count`, seed 0.

    Raises:
      ValueError: where there are fewer templates than a row needs.
    """
    if count < size:
        raise ValueError(
            f"Expected at least {size} validation shapes with all keypoints, but there "
            f"are {count}; give a run with more --config.data.val_models."
        )
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, size, replace=False) for _ in range(pairs)])


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
    *,
    labels: Mapping[str, str],
    point_labels: Sequence[np.ndarray],
    methods: Sequence[str] = tuple(METHODS),
) -> dict[str, Any]:
    """Measures of the transfer from pairs of templates to all shapes, and of baselines.

    Args:
      templates: validation shapes that have all keypoints. shapes: test shapes.
      pairs: [P, T] rows of templates.
      labels: of the K keypoints, by name.
      point_labels: of the test shapes' points, see `label_shapes`.
      methods: of `METHODS`, "index" among them.

    Returns:
      Under "by" for each of `METHODS`: `right_part`, the share of points whose nearest
      true surface belongs to the keypoint's part, 0 to 1; `distance` to the shape's own
      keypoint, object units; `follows`, see `measure_following`. `_spread` is the
      standard deviation over pairs, `_spread_shapes` over shapes. The figures of
      "index" also stand alone; `points` is how many a keypoint has on average.
    """
    rng = np.random.default_rng(0)
    made = [_make_pair(templates, rows, rng) for rows in pairs]
    by = {}
    for method in methods:
        results = [
            _transfer(method, pair, shapes, point_labels, list(labels.values()))
            for pair in made
        ]
        right, distance, follows = map(np.array, zip(*results, strict=True))
        by[method] = _summarize(right, distance, follows, labels)
    alone = {key: value for key, value in by["index"].items() if "_by_" not in key}
    return alone | {
        "points": float(np.mean([len(i) for pair in made for i in pair.found])),
        "radius": RADIUS,
        "template_pairs": len(pairs),
        "shapes": len(shapes.seeds),
        "category": shapes.category,
        "by": by,
    }


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


def _summarize(right, distance, follows, labels) -> dict[str, Any]:
    """Figures of one method from right and distance [P, S, K] and follows [P]."""
    summary = {}
    for name, values in (("right_part", right), ("distance", distance)):
        over_pairs = _mean(values.reshape(len(values), -1), axis=1)
        summary |= {
            name: float(over_pairs.mean()),
            f"{name}_spread": float(over_pairs.std()),
            f"{name}_spread_shapes": float(np.nanstd(_mean(values, axis=(0, 2)))),
            f"{name}_by_keypoint": dict(
                zip(labels, _mean(values, axis=(0, 1)).tolist(), strict=True)
            ),
        }
    spread = {"follows_spread": float(follows.std())}
    return summary | {"follows": float(follows.mean())} | spread


def _mean(values, axis):
    """Mean of what is known; NaN where nothing is, without a warning."""
    known = np.isfinite(values)
    total, count = np.where(known, values, 0.0).sum(axis=axis), known.sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


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
