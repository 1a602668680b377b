"""Every number of the paper's §§ Datasets, Network architecture, Training details."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from config_files import load, parameter_shapes

from dpc_jax.config import ELEVATIONS
from dpc_jax.learning.optimizer import make_learning_rate, make_optimizer
from dpc_jax.learning.schedules import compute_sigma
from dpc_jax.networks.encoder import leaky_relu
from dpc_jax.run.setup import make_data_specs, make_network

CATEGORIES = {  # models to train, validate and test on, in the split of § Datasets
    "airplane": (2831, 404, 810),
    "car": (5247, 750, 1500),
    "chair": (4744, 678, 1356),
}
SIDES = {32: 2000, 64: 8000, 128: 16_000}  # and points (§ Training details)


@pytest.mark.parametrize("category", CATEGORIES)
def test_datasets_three_categories_five_random_views_and_the_published_counts(category):
    specs = make_data_specs(load(category, "paper"))
    counts = tuple(specs[split].models for split in ("train", "val", "test"))
    assert counts == CATEGORIES[category]
    for spec in specs.values():
        assert spec.category == category
        assert spec.views == 5
        # "[-20°, 40°]"; azimuths are drawn from all 360° (tests/test_data_views.py).
        assert ELEVATIONS == (-20.0, 40.0)


def test_training_adam_with_a_fixed_rate_and_the_standard_momenta():
    train = load("car", "paper").train
    assert train.steps == 600_000
    rate = make_learning_rate(train)
    for step in (0, 1, 300_000, 599_999):
        assert float(rate(step)) == pytest.approx(1e-4, rel=1e-6)  # float32
    assert train.l2_weight == 0
    # Sixteen samples.
    assert (train.models_per_batch, train.views_per_batch) == (4, 4)
    optimizer = make_optimizer(train)
    params = {"w": jnp.array(0.0)}
    _, state = optimizer.update({"w": jnp.array(1.0)}, optimizer.init(params), params)
    moments = jax.tree.leaves(state[0].mu) + jax.tree.leaves(state[0].nu)
    # After one gradient of 1: 1 - 0.9 and 1 - 0.999 (Kingma and Ba).
    np.testing.assert_allclose(moments, [0.1, 0.001], rtol=1e-4)


@pytest.mark.parametrize("side", SIDES)
def test_training_dropout_falls_from_90_percent_and_points_from_5_to_a_third(side):
    config = load("car", f"paper,{side}")
    render, steps = config.render, config.train.steps
    assert (config.data.image_size, render.grid, render.fine_grid) == (side, side, 0)
    assert (render.keep_start, render.keep_end) == (0.1, 1.0)
    sizes = [
        float(compute_sigma(s, render, steps=steps)) / side
        for s in (0, steps // 2, steps)
    ]
    np.testing.assert_allclose(sizes, [0.05, 0.0265, 0.003], rtol=1e-5)  # float32


def list_convolutions(shapes):
    count = sum(name.startswith("encoder/Conv") for name in shapes) // 2
    return [shapes[f"encoder/Conv_{i}/kernel"] for i in range(count)]


@pytest.mark.parametrize("side, points", SIDES.items())
def test_network_seven_convolutions_and_a_shape_branch_of_3n_outputs(side, points):
    config = load("car", f"paper,known_pose,{side}")
    _, shapes = parameter_shapes(config)
    kernels = list_convolutions(shapes)
    assert len(kernels) == 7
    assert kernels[0] == (5, 5, 3, 16)
    assert all(kernel[:2] == (3, 3) for kernel in kernels[1:])
    # "The number of channels grows by a factor of 2 after each strided layer."
    channels = [kernel[3] for kernel in kernels]
    assert channels == [16, 32, 32, 64, 64, 128, 128]
    # Four halvings: what the dense layer sees has a sixteenth of the side.
    flat = shapes["encoder/Dense_0/kernel"]
    assert flat == ((side // 16) ** 2 * 128, 1024)
    assert shapes["encoder/Dense_1/kernel"] == (1024, 1024)
    assert "encoder/Dense_2/kernel" not in shapes
    branch = {n: s for n, s in shapes.items() if n.startswith("shape/")}
    kernels = {n.split("/")[1]: s for n, s in branch.items() if n.endswith("kernel")}
    assert kernels == {
        "Dense_0": (1024, 1024),
        "points": (1024, 3 * points),
        "scale": (1024, 1),
    }


def test_network_four_pose_heads_of_two_layers_behind_a_shared_one():
    config = load("car", "paper")
    assert config.pose.num_heads == config.pose.learned_heads == 4
    _, shapes = parameter_shapes(config)
    kernels = {n: s for n, s in shapes.items() if n.endswith("kernel")}
    assert {n: s for n, s in kernels.items() if n.startswith("pose/")} == {
        "pose/Dense_0/kernel": (1024, 1024),
        "pose/heads/Dense_0/kernel": (4, 1024, 32),
        "pose/heads/Dense_1/kernel": (4, 32, 32),
        "pose/heads/Dense_2/kernel": (4, 32, 4),
    }
    # "The student model is another branch with the same architecture."
    assert {n: s for n, s in kernels.items() if n.startswith("student/")} == {
        "student/Dense_0/kernel": (1024, 1024),
        "student/head/Dense_0/kernel": (1024, 32),
        "student/head/Dense_1/kernel": (32, 32),
        "student/head/Dense_2/kernel": (32, 4),
    }


def test_network_leaky_relu_of_slope_a_fifth_and_no_normalisation():
    assert float(leaky_relu(jnp.array(-1.0))) == pytest.approx(-0.2)
    network = make_network(load("car", "paper"))
    assert network.pose.slope == network.student.slope == 0.2
    assert not (network.encoder.normalize or network.pose.spreads)


@pytest.mark.parametrize("variant", ["paper", "paper,naive", "paper,known_pose,128"])
def test_nothing_beyond_the_paper_is_on(variant):
    config = load("car", variant)
    pose, train = config.pose, config.train
    assert not (pose.flips or pose.selects or pose.source == "labels")
    assert not (pose.common_frame or pose.translation or pose.focal_length)
    assert not (train.repulsion_weight or train.containment_weight)
    assert not train.framed_views and not train.spread_masks
    assert not (train.pull_weight or train.depth_weight or train.color_weight)
    assert (train.silhouette_weight, train.background_weight) == (1, 0)
    assert train.colors_move_points
    assert not config.network.sees_mask
    assert config.network.shape == "points" and not config.network.point_size
    assert config.render.ray_rule == "termination"
    assert config.render.anneal_until == 1 and config.data.copies == 1
    # The learned scale is the peak of a point, c_i of Eq. 3.
    assert config.render.scale_unit == "peak" and not config.render.scale_fixed
    # All four candidates are compared exactly, whatever ranks them first.
    assert pose.choice_top == 0
