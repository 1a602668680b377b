"""MVC: poses drawn by their probabilities, REINFORCE, and the judge of the prior."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import scipy.stats
from tiny_runs import copy, make_batch, make_network, make_state, make_step, tiny_config

from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.evaluation.rotations import view_angles
from dpc_jax.learning.candidates import Poses
from dpc_jax.learning.poses import sampled
from dpc_jax.networks.viewpoints import ViewpointEnsemble, face_object

DRAWN = {"source": "sampled", "head": "viewpoint", "student": "selects"}
CONFIG = tiny_config(background_weight=0.2, shape="voxels", **DRAWN)
NETWORK = make_network(CONFIG)


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (50, 30), (200, -15)])
def test_a_viewpoint_is_that_of_the_data(azimuth, elevation):
    angles = np.deg2rad([azimuth, elevation])
    found = face_object(jnp.array(angles[0]), jnp.array(angles[1]))
    expected = matrix_to_quaternion(look_at_rotation(*angles))
    assert abs(float(jnp.sum(found * expected))) == pytest.approx(1, abs=1e-6)


def test_heads_start_in_equal_steps_and_never_leave_the_known_elevations():
    module = ViewpointEnsemble(8, (-20.0, 40.0), hidden=16)
    features = jax.random.normal(jax.random.key(0), (3, 12))
    params = jax.jit(module.init)(jax.random.key(1), features)
    azimuths, elevations = view_angles(module.apply(params, 1e-3 * features))
    # From 180° on, where the sigmoid of 0 is; the middle of -20° and 40°.
    steps = azimuths.reshape(3, 8) - 180 - 45 * np.arange(8)
    np.testing.assert_allclose((steps + 180) % 360, 180, atol=0.1)
    np.testing.assert_allclose(elevations, 10, atol=0.1)
    wild = jax.tree.map(lambda a: 40 * a, params)
    azimuths, elevations = view_angles(module.apply(wild, 40 * features))
    assert elevations.min() >= -20.01 and elevations.max() <= 40.01
    assert np.ptp(elevations) > 50


@pytest.mark.parametrize("baseline", [0.0, 1.3, -7.0])
def test_reinforce_summed_over_all_draws_is_the_gradient_of_the_expected_cost(baseline):
    logits = jnp.array([[0.3, -1.0, 0.8, 0.1]])
    costs = jnp.array([2.0, 0.5, 3.0, 1.0])
    chances = np.asarray(jax.nn.softmax(logits[0]), np.float64)
    total = np.zeros(4)
    for head in range(4):
        slopes = jax.grad(sampled.reinforce_loss, (0, 2, 3))(
            logits, jnp.array([head]), costs[head][None], jnp.array(baseline)
        )
        assert not np.any(slopes[1]) and not np.any(slopes[2])
        total += chances[head] * np.asarray(slopes[0][0])
    expected = chances * (np.asarray(costs) - chances @ np.asarray(costs))
    np.testing.assert_allclose(total, expected, atol=1e-6)  # float32


def test_entropy_is_the_mean_over_views():
    chances = np.array([[0.5, 0.2, 0.3], [1.0, 1.0, 1.0]])
    expected = scipy.stats.entropy(chances, axis=1).mean()
    found = sampled.measure_entropy(jnp.log(chances))
    assert float(found) == pytest.approx(expected, rel=1e-6)


def test_heads_are_drawn_as_often_as_their_probability_says():
    logits = jnp.log(jnp.array([0.5, 0.2, 0.3]))
    candidates = jax.random.normal(jax.random.key(1), (2000, 3, 4))
    poses = Poses(candidates, None, jnp.tile(logits, (2000, 1)))
    drawn = sampled.draw_poses(poses, jax.random.split(jax.random.key(0), 2000))
    shares = np.bincount(np.asarray(drawn.indices), minlength=3) / 2000
    # Three standard deviations of a share of 0.5 among 2000 are 0.034.
    np.testing.assert_allclose(shares, [0.5, 0.2, 0.3], atol=0.035)
    for view in (0, 7, 1999):
        own = candidates[view, drawn.indices[view]]
        np.testing.assert_array_equal(drawn.poses[view], own)


@pytest.fixture(scope="module")
def state():
    return make_state(NETWORK, CONFIG)


def judge(params, poses, key):
    keys = jax.random.split(key, poses.shape[0])
    return sampled.judge_poses(params, poses, keys, network=NETWORK)


def test_the_judge_learns_nothing_for_the_poses_and_they_nothing_for_it(state):
    params, poses = state.params, jax.random.normal(jax.random.key(2), (6, 4))

    def differentiate(index):
        def total(params, poses):
            return jnp.sum(judge(params, poses, jax.random.key(3))[index])

        return jax.jit(jax.grad(total, (0, 1)))(params, poses)

    by_params, by_poses = differentiate(0)
    assert not any(np.any(a) for a in jax.tree.leaves(by_params)) and np.any(by_poses)
    by_params, by_poses = differentiate(1)
    own = jax.tree.leaves(by_params["params"]["judge"])
    assert all(np.any(leaf) for leaf in own) and not np.any(by_poses)


def test_the_prior_moves_a_collapsed_distribution(state):
    """Azimuths that all lie within a few degrees spread around the object."""
    params = state.params["params"]
    angles = 0.05 * jax.random.normal(jax.random.key(5), (64,))
    optimizer = optax.adam(0.02)
    learned = (params["judge"], angles)

    def compare(learned, key):
        weights, azimuths = learned
        poses = face_object(azimuths, jnp.full_like(azimuths, 0.17))
        whole = {"params": params | {"judge": weights}}
        unlikely, loss = judge(whole, poses, key)
        return jnp.sum(unlikely) / 8 + loss

    def step(carried, key):
        learned, state = carried
        slopes = jax.grad(compare)(learned, key)
        updates, state = optimizer.update(slopes, state)
        return (optax.apply_updates(learned, updates), state), None

    def concentrate(azimuths):
        """1 where all agree, 0 of a uniform distribution."""
        return float(jnp.abs(jnp.mean(jnp.exp(1j * azimuths))))

    assert concentrate(angles) > 0.99
    keys = jax.random.split(jax.random.key(6), 600)
    start = learned, optimizer.init(learned)
    (learned, _), _ = jax.jit(lambda start: jax.lax.scan(step, start, keys))(start)
    assert concentrate(learned[1]) < 0.6


def test_a_step_has_all_terms_with_their_weights(state):
    new, metrics = make_step(NETWORK, CONFIG)(copy(state), make_batch())
    pixels = CONFIG.render.grid**2
    cost = metrics["reprojection"] + 0.1 * pixels * metrics["prior"]
    assert float(new.averages.cost) == pytest.approx(0.05 * float(cost), rel=1e-5)
    rest = metrics["judge"] + metrics["reinforce"]
    # The reward of entropy is a share of the baseline.
    reward = 0.05 * new.averages.cost * metrics["head_entropy"]
    assert float(metrics["loss"]) == pytest.approx(float(cost + rest - reward))


def test_poses_and_shapes_have_encoders_of_their_own(state):
    params = state.params
    images = jax.random.normal(jax.random.key(0), (2, 16, 16, 3))

    def read(part, method):
        def total(params):
            features = NETWORK.apply(params, images, method="encode")
            output = NETWORK.apply(params, features, method=method)
            return jnp.sum(output[part] ** 2)

        slopes = jax.jit(jax.grad(total))(params)["params"]
        names = ("encoder", "pose_encoder")
        return [any(map(np.any, jax.tree.leaves(slopes[name]))) for name in names]

    assert read("cells", "predict_shape") == [True, False]
    assert read("logits", "predict_pose") == [False, True]
