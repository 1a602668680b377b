"""What the scaling coefficient and the penalty on weights do, in both their forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_network, tiny_config

from dpc_jax.learning.predictions import predict_shapes
from dpc_jax.learning.shapes.points import compute_mass
from dpc_jax.learning.step import find_penalized, make_optimizer
from dpc_jax.render import Camera, VoxelGrid, mass_of_peak, voxelize

pytestmark = pytest.mark.usefixtures("quickly")

SIDE = 33  # odd: the origin is a cell's centre


def occupy(scale, sigma, unit):
    """The volume of one point at a cell's centre."""
    mass = compute_mass(jnp.array(scale), jnp.array(sigma), scale_unit=unit)
    return voxelize(
        jnp.zeros((1, 3)),
        jnp.array([1.0, 0, 0, 0]),
        sigma=sigma,
        scale=mass,
        camera=Camera(projection="orthographic"),
        grid=VoxelGrid(SIDE),
    )


@pytest.mark.parametrize("sigma", [0.2, 1.0, 1.6])
@pytest.mark.parametrize("scale", [0.3, 0.9])
def test_in_unit_peak_a_point_fills_its_cell_by_the_coefficient(scale, sigma):
    volume = occupy(scale, sigma, "peak")
    middle = SIDE // 2
    assert float(volume[middle, middle, middle]) == pytest.approx(scale, rel=1e-4)
    # Its neighbour as Eq. 3 says: c·exp(-1 / 2σ²).
    beside = float(volume[middle, middle, middle + 1])
    assert beside == pytest.approx(scale * np.exp(-0.5 / sigma**2), rel=1e-3)


@pytest.mark.parametrize("sigma", [0.2, 1.0, 1.6])
def test_in_unit_mass_the_cells_of_a_point_sum_to_the_coefficient(sigma):
    volume = occupy(0.9, sigma, "mass")
    assert float(jnp.sum(volume)) == pytest.approx(0.9, rel=1e-4)


def test_at_the_first_step_at_64_a_mass_is_500_times_thinner_than_a_peak():
    # σ = 5 % of 64 = 3.2 voxels: (2π)^1.5·3.2³ = 516.
    peak = compute_mass(jnp.array(1.0), jnp.array(3.2), scale_unit="peak")
    mass = compute_mass(jnp.array(1.0), jnp.array(3.2), scale_unit="mass")
    assert float(peak / mass) == pytest.approx(516.1, rel=1e-3)


@pytest.mark.parametrize(("sigma", "share"), [(1.6, 1.0), (0.7, 1.0), (0.2, 0.126)])
def test_the_peak_of_a_thin_points_density_is_not_that_of_its_samples(sigma, share):
    density = mass_of_peak(1.0, sigma)
    samples = compute_mass(jnp.array(1.0), jnp.array(sigma), scale_unit="peak")
    # Of a thin point the sample at its centre is its mass: (2π)^1.5·0.2³ = 0.126.
    assert float(density / samples) == pytest.approx(share, rel=1e-3)


def test_a_fixed_scale_is_that_number_for_every_object():
    config = tiny_config(source="given", scale_fixed=0.7)
    network = make_network(config)
    params = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, 16, 16, 3)))
    features = jax.random.normal(jax.random.key(1), (2, 12))
    shapes = predict_shapes(
        params,
        features,
        jax.random.split(jax.random.key(2), 2),
        jnp.array(1.0),
        network=network,
        render=config.render,
        kept_points=5,
    )
    np.testing.assert_array_equal(shapes.scale, np.float32([0.7, 0.7]))
    np.testing.assert_array_equal(shapes.mass, np.float32([0.7, 0.7]))
    assert "scale" not in params["params"]["shape"]


def make_params():
    rng = np.random.default_rng(0)

    def layer():
        return {
            "kernel": jnp.asarray(rng.normal(size=3)),
            "bias": jnp.asarray(rng.normal(size=3)),
        }

    return {"params": {n: {"Dense_0": layer()} for n in ("encoder", "shape", "pose")}}


def test_the_penalty_is_for_weights_of_encoder_and_shape_only():
    chosen = find_penalized(make_params())["params"]
    assert {n: branch["Dense_0"] for n, branch in chosen.items()} == {
        "encoder": {"kernel": True, "bias": False},
        "shape": {"kernel": True, "bias": False},
        "pose": {"kernel": False, "bias": False},
    }


def test_the_penalty_is_half_the_squared_weights_in_the_loss_before_adam():
    params = make_params()
    chosen = find_penalized(params)

    def penalty(tree):
        squares = jax.tree.map(lambda a, on: jnp.sum(a**2) * on, tree, chosen)
        return 0.5 * 0.01 * sum(jax.tree.leaves(squares))

    plain, ours = (
        make_optimizer(tiny_config(l2_weight=weight).train) for weight in (0.0, 0.01)
    )
    gradient = jax.tree.map(jnp.cos, params)
    whole = jax.tree.map(jnp.add, gradient, jax.grad(penalty)(params))
    expected, _ = plain.update(whole, plain.init(params), params)
    found, _ = ours.update(gradient, ours.init(params), params)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), found, expected
    )
