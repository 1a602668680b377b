"""Reports of made-up runs, shared by the tests of the page."""

import numpy as np

from dpc_jax.evaluation.images import ViewImages
from dpc_jax.evaluation.metrics import REQUIRED_METRICS
from dpc_jax.evaluation.pose import Failures
from dpc_jax.reporting.examples import Example, Neighbour
from dpc_jax.reporting.page import write_report

GROUPS = ("Worst", "Median", "Best")
# Of a report in which nothing is drawn.
NO_FIGURES = {"records": (), "examples": ()}


def make_images(rng):
    """A view's images of all signals."""
    share = np.pad(np.ones((8, 8)), ((2, 2), (1, 3)))
    pair = {"silhouette": share}, {"silhouette": share.T}
    for images in pair:
        images["depth"] = rng.uniform(1.6, 2.4, (12, 12))
        images["color"] = rng.uniform(size=(12, 12, 3))
    return ViewImages(share, *pair)


def make_example(name, *, group="", has_truth=True, seed=0):
    """An ellipsoid of points, predicted a little too large."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = directions * [0.4, 0.2, 0.15]
    known = {}
    if has_truth:
        near = (Neighbour("Nearest training shape", truth, 2.0),)
        known = {"surface": truth, "images": make_images(rng), "neighbours": near}
    return Example(
        name=name,
        image=rng.integers(0, 256, (16, 16, 3)).astype(np.uint8),
        target=rng.uniform(size=(16, 16)),
        predicted=rng.uniform(size=(32, 32)),  # of its own size
        points=1.1 * truth,
        colors=rng.uniform(size=(300, 3)),
        pose_error_deg=12.0 if has_truth else None,
        group=group,
        chamfer=4.2 if has_truth else None,
        overlap=0.9,
        **known,
    )


def make_report(folder, *, has_truth=True, **changes):
    """The report of a run, with every section that there can be; returns its path.

    Args:
      changes: arguments of `write_report` to be put in, its metrics beside the others.
    """
    examples = [
        make_example(f"car-{i}", group=group, has_truth=has_truth, seed=i)
        for i, group in enumerate(GROUPS)
    ]
    validation = {"silhouette_iou": 0.8}
    if has_truth:
        validation |= {"pose_accuracy": 0.6, "chamfer": 4.0}
    records = [
        {"step": s, "seconds": s / 10, "loss": 9.0 / s, "head_shares": [0.99, 0.01]}
        for s in range(10, 110, 10)
    ]
    records.append({"step": 100, "seconds": 10.0, **validation})
    metrics = dict.fromkeys(REQUIRED_METRICS) | {"silhouette_iou": 0.9}
    more = {}
    if has_truth:
        metrics |= {"chamfer": 4.2, "wrong_half_turn_share": 0.5}
        angles = np.arange(0.0, 360, 10)
        kinds = np.where(angles < 180, -1, 0)
        errors = np.where(angles < 180, 4.0, 178.0)
        failures = Failures(errors, angles, kinds, {})
        metrics |= {"floor_chamfer": 1.8, "mean_shape_chamfer": 5.0}
        more = {"failures": failures}
    arguments = {
        "title": "Cars & <b>more</b>, a rather long name, as folders often have",
        "metrics": metrics | changes.pop("metrics", {}),
        "records": records,
        "examples": examples,
        "ranking": "The worst, median and best of all test views by pose error.",
        "warnings": ["3 meshes < 5 could not be read."],
        "config_text": "a = '<script>alert(1)</script>'" + " steps = 100" * 30,
    }
    return write_report(folder, **(arguments | more | changes))
