"""Reports of made-up runs, shared by the tests of the page."""

import numpy as np

from dpc_jax.evaluation.images import ViewImages
from dpc_jax.evaluation.metrics import REQUIRED_METRICS
from dpc_jax.evaluation.pose import Failures
from dpc_jax.reporting.examples import Example, Neighbour, TrainingComparison
from dpc_jax.reporting.page import write_report


def show_depths(target, rendered):
    """The images of a view with these depths, as if they were silhouettes, too."""
    target, rendered = (
        dict.fromkeys(("silhouette", "depth"), a) for a in (target, rendered)
    )
    return ViewImages(target["silhouette"], target, rendered)


def make_example(name, *, group="", has_truth=True, has_colors=True, seed=0):
    """An ellipsoid of points, predicted a little too large."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = directions * [0.4, 0.2, 0.15]
    images = rng.uniform(size=(2, 16, 16))
    return Example(
        name=name,
        image=rng.integers(0, 256, (16, 16, 3)).astype(np.uint8),
        target=images[0],
        predicted=images[1],
        points=1.1 * truth,
        colors=rng.uniform(size=(300, 3)) if has_colors else None,
        pose_error_deg=12.0 if has_truth else None,
        surface=truth if has_truth else None,
        images=show_depths(*images) if has_truth else None,
        group=group,
        chamfer=4.2 if has_truth else None,
        overlap=0.9,
        neighbours=(Neighbour("Nearest training shape", truth, 2.0),)
        if has_truth
        else (),
    )


def make_report(folder, *, has_truth=True):
    """The report of a run, with every section that there can be; returns its path."""
    groups = ("Worst", "Median", "Best")
    examples = [
        make_example(f"car-{i}", group=group, has_truth=has_truth, seed=i)
        for i, group in enumerate(groups)
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
        azimuths = np.stack([angles, (angles + errors) % 360])
        failures = Failures(errors, azimuths, kinds, np.zeros(0, int), {})
        near = {"Prediction": 4.2, "Mean training shape": 5.0}
        comparison = TrainingComparison(24, near, {"Mean training shape": 3.0})
        more = {"pose_errors": errors, "failures": failures, "comparison": comparison}
    return write_report(
        folder,
        title="A run with a rather long name, as folders of experiments often have",
        metrics=metrics,
        records=records,
        stages=[(0, "100 points"), (50, "200 points, 64³ cells")],
        examples=examples,
        ranking="The worst, median and best of all test views by pose error.",
        shares=[0.99, 0.01],
        warnings=["A warning."],
        config_text="steps = 100 " * 30,
        **more,
    )
