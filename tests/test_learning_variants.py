"""What every variant does: it learns, goes on from a checkpoint, and predicts."""

import contextlib

import jax
import numpy as np
import pytest
from tiny_runs import (
    assert_same_bits,
    copy,
    make_batch,
    make_dataset,
    make_network,
    make_state,
    make_step,
    tiny_config,
)

from dpc_jax.config import check, replace_fields
from dpc_jax.learning import batches
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.training.checkpoints import Checkpoints

# fields; losses beside the sum, and branches of the network, that there are then
VARIANTS = {
    "paper": ({}, {"reprojection", "student"}, {"pose", "student"}),
    "defaults": (
        {"head": "viewpoint", "student": "selects", "flips": True}
        | {"common_frame": "colors", "sees_mask": True, "fine_grid": 16}
        | {"framed_views": True}
        | {"choice_top": 3}
        | {"pull_weight": 0.1, "repulsion_weight": 0.1, "containment_weight": 30.0},
        {"reprojection", "student", "pull", "repulsion", "containment", "turned_back"},
        {"pose", "student"},
    ),
    "known_pose,color": (
        {"source": "given", "color_weight": 0.3, "colors_move_points": False},
        {"reprojection", "color"},
        set(),
    ),
    "gt_pose": (
        {"source": "labels", "student": "selects"},
        {"reprojection", "labels", "student"},
        {"pose", "student"},
    ),
    "mvc,color": (
        {"shape": "voxels", "source": "sampled", "background_weight": 0.2}
        | {"color_weight": 0.3, "head": "viewpoint", "student": "selects"},
        {"reprojection", "color", "prior", "judge", "reinforce", "head_entropy"},
        {"pose", "pose_encoder", "student", "judge"},
    ),
    "cameras, depth alone": (
        {"silhouette_weight": 0.0, "depth_weight": 1.0, "translation": True},
        {"depth", "camera_mean", "student"},
        {"pose", "student", "translation", "focal"},
    ),
    "epcg": (
        {"shape": "maps", "source": "given", "depth_weight": 1.0},
        {"pixel_deviation", "depth"},
        set(),
    ),
}
# The others are combinations of its parts, or what test_main_pipeline.py trains.
OFTEN = ("mvc,color",)


def make_views(config):
    """A batch with all that a config reads."""
    rng, batch = np.random.default_rng(0), make_batch()
    size = batch["masks"].shape[-1]
    if config.pose.source in ("unknown", "sampled"):  # learned from images alone
        del batch["quaternions"]
    if "depths" in batches.list_extras(config):
        batch["depths"] = rng.uniform(1.6, 2.4, batch["masks"].shape).astype(np.float32)
    if config.network.shape == "maps":
        corners = len(batch["masks"]), 8, size, size
        batch["corner_masks"] = rng.integers(0, 255, corners, np.uint8)
        batch["corner_depths"] = rng.uniform(1.6, 2.4, corners).astype(np.float32)
    return batch


def go_on(step, state, batch, count):
    metrics = {}
    for _ in range(count):
        state, metrics = step(state, batch)
    return state, jax.device_get(metrics)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in OFTEN else pytest.mark.slow)
        for name in VARIANTS
    ],
)
def test_a_variant_learns_goes_on_from_a_checkpoint_and_predicts(name, tmp_path):
    fields, losses, branches = VARIANTS[name]
    config = tiny_config(**fields)
    if config.pose.translation:  # the camera has a field of the other name, too
        config = replace_fields(config, {"pose": {"focal_length": True}})
    check(config)
    network, batch = make_network(config), make_views(config)
    first, step = make_state(network, config), make_step(network, config)
    assert set(first.params["params"]) == {"encoder", "shape"} | branches

    second, metrics = go_on(step, copy(first), batch, 1)
    assert losses <= set(metrics)
    assert ("winners" in metrics) == (config.pose.source != "given")
    assert np.isfinite([metrics["loss"], *(metrics[loss] for loss in losses)]).all()
    norms = metrics["gradient_norms"]
    assert np.isfinite(list(norms.values())).all() and min(norms.values()) > 0
    changed = jax.tree.map(
        lambda old, new: bool((np.asarray(old) != new).any()),
        first.params["params"],
        second.params["params"],
    )
    assert all(any(jax.tree.leaves(branch)) for branch in changed.values())

    with contextlib.closing(Checkpoints(tmp_path / "checkpoints")) as kept:
        kept.save(copy(second), seconds=1.0)
    with contextlib.closing(Checkpoints(tmp_path / "checkpoints")) as kept:
        restored = kept.restore(first)
    last, found = go_on(step, copy(second), batch, 2)
    again, same = go_on(step, restored.state, batch, 2)
    assert_same_bits(again, last)
    assert_same_bits(same, found)

    predictions = predict_all(make_predictor(network, config), last, make_dataset())
    assert predictions.silhouettes.shape == (3, 3, *[config.render.finest] * 2)
    assert (predictions.cells is None) == (config.network.shape != "voxels")
    has_colors = config.train.color_weight and config.network.shape == "points"
    assert (predictions.colors is None) == (not has_colors)
    for array in predictions:
        assert array is None or np.isfinite(array).all()
