"""MVC: poses drawn by their probabilities, REINFORCE, and the judge of the prior."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from tiny_runs import make_batch, make_network, make_state, make_step, tiny_config

from dpc_jax.config import build_config, check, replace_fields
from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.learning.choice.batch_choice import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.pose_prior import judge_poses
from dpc_jax.learning.poses import sampled as sampling
from dpc_jax.learning.predictions import Poses
from dpc_jax.learning.signals import sum_event_costs
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.viewpoints import ViewpointEnsemble, face_object
from dpc_jax.render import VoxelGrid, project_volume, quaternion

pytestmark = pytest.mark.usefixtures("quickly")


def mvc_config(**fields):
    base = tiny_config(background_weight=0.2, **fields)
    changes = {"network": {"shape": "voxels"}, "pose": {"source": "sampled"}}
    return replace_fields(base, changes)


def read_angles(quaternions):
    """Azimuth and elevation of upright cameras, by where they sit; degrees."""
    matrices = jax.vmap(quaternion.to_matrix)(jnp.reshape(quaternions, (-1, 4)))
    places = -np.asarray(matrices)[:, 2]  # opposite to where they look
    azimuths = np.degrees(np.arctan2(places[:, 1], places[:, 0])) % 360
    return azimuths, np.degrees(np.arcsin(places[:, 2]))


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (50, 30), (200, -15)])
def test_a_viewpoint_is_that_of_the_data(azimuth, elevation):
    angles = np.deg2rad([azimuth, elevation])
    found = face_object(jnp.array(angles[0]), jnp.array(angles[1]))
    expected = matrix_to_quaternion(look_at_rotation(*angles))
    assert abs(float(jnp.sum(found * expected))) == pytest.approx(1, abs=1e-6)


def test_heads_start_in_equal_steps_and_never_leave_the_known_elevations():
    module = ViewpointEnsemble(8, (-20.0, 40.0), hidden=16)
    features = jax.random.normal(jax.random.key(0), (3, 12))
    params = module.init(jax.random.key(1), features)
    azimuths, elevations = read_angles(module.apply(params, 1e-3 * features))
    # From 180° on, where the sigmoid of 0 is; the middle of -20° and 40°.
    steps = azimuths.reshape(3, 8) - 180 - 45 * np.arange(8)
    np.testing.assert_allclose((steps + 180) % 360, 180, atol=0.1)
    np.testing.assert_allclose(elevations, 10, atol=0.1)
    wild = jax.tree.map(lambda a: 40 * a, params)
    azimuths, elevations = read_angles(module.apply(wild, 40 * features))
    assert elevations.min() >= -20.01 and elevations.max() <= 40.01
    assert np.ptp(elevations) > 50


@pytest.mark.parametrize("baseline", [0.0, 1.3, -7.0])
def test_reinforce_summed_over_all_draws_is_the_gradient_of_the_expected_cost(baseline):
    logits = jnp.array([[0.3, -1.0, 0.8, 0.1]])
    costs = jnp.array([2.0, 0.5, 3.0, 1.0])
    chances = np.asarray(jax.nn.softmax(logits[0]), np.float64)
    total = np.zeros(4)
    for head in range(4):
        slope = jax.grad(sampling.reinforce_loss)(
            logits, jnp.array([head]), costs[head][None], jnp.array(baseline)
        )
        total += chances[head] * np.asarray(slope[0])
    expected = chances * (np.asarray(costs) - chances @ np.asarray(costs))
    np.testing.assert_allclose(total, expected, atol=1e-6)  # float32


def test_with_entropy_rewarded_the_best_probabilities_are_those_of_gibbs():
    """Expected cost less τ times entropy is least at p ∝ exp(-cost/τ)."""
    costs, reward = jnp.array([2.0, 0.5, 3.0, 1.0]), 0.7

    def slope(logits):
        def compare(logits):
            expected = jnp.sum(jax.nn.softmax(logits[0]) * costs)
            return expected - reward * sampling.measure_entropy(logits)

        return np.asarray(jax.grad(compare)(logits))

    np.testing.assert_allclose(slope(-costs[None] / reward), 0, atol=1e-6)  # float32
    assert np.abs(slope(-costs[None] / 2)).max() > 0.01
    even = float(sampling.measure_entropy(jnp.zeros((3, 4))))
    assert even == pytest.approx(np.log(4))


def test_the_reward_of_entropy_is_a_share_of_the_baseline(monkeypatch):
    nothing = jnp.zeros(4), jnp.zeros(())
    monkeypatch.setattr(sampling, "judge_poses", lambda *_, **__: nothing)
    poses = Poses(jnp.ones((4, 2, 4)), None, jnp.tile(jnp.array([3.0, 0.0]), (4, 1)))
    winners = Winners(jnp.ones((2, 2, 4)), jnp.zeros((2, 2), jnp.int32))

    def compare(costs):
        terms, baseline = sampling.compare_drawn(
            {},
            poses,
            winners,
            costs,
            jnp.array(6.0),
            jax.random.split(jax.random.key(0), 2),
            network=make_network(mvc_config()),
            weight=0.0,
        )
        return terms["head_entropy"], baseline

    one_device = jax.vmap(compare, axis_name=AXIS)
    (entropy, weight), baseline = one_device(jnp.full((1, 4), 6.0))
    np.testing.assert_allclose(weight, -0.05 * baseline)
    np.testing.assert_allclose(entropy, sampling.measure_entropy(poses.logits)[None])


def test_costs_and_baseline_get_no_gradient():
    logits, indices = jnp.array([[0.3, -1.0]]), jnp.array([1])
    slopes = jax.grad(sampling.reinforce_loss, (2, 3))(
        logits, indices, jnp.array([2.0]), jnp.array(0.5)
    )
    assert not any(np.any(slope) for slope in slopes)


def test_heads_are_drawn_as_often_as_their_probability_says():
    logits = jnp.log(jnp.array([0.5, 0.2, 0.3]))
    count, views = 400, 5
    candidates = jax.random.normal(jax.random.key(1), (count * views, 3, 4))
    poses = Poses(candidates, None, jnp.tile(logits, (count * views, 1)))
    keys = jax.random.split(jax.random.key(0), count)
    drawn = sampling.draw_poses(poses, keys, views=views)
    assert drawn.poses.shape == (count, views, 4)
    shares = np.bincount(np.asarray(drawn.indices).ravel(), minlength=3) / 2000
    # Three standard deviations of a share of 0.5 among 2000 are 0.034.
    np.testing.assert_allclose(shares, [0.5, 0.2, 0.3], atol=0.035)
    for row, view in itertools.product((0, 7), (0, 4)):
        own = candidates[row * views + view, drawn.indices[row, view]]
        np.testing.assert_array_equal(drawn.poses[row, view], own)
    again = sampling.draw_poses(poses, keys, views=views)
    np.testing.assert_array_equal(drawn.indices, again.indices)


def test_around_a_known_shape_event_costs_are_least_at_the_true_azimuth():
    """A lopsided body of boxes and every fifth azimuth, to one step.

    Not to none: event costs are linear in S, and the rim of a body of cells is soft.
    """
    cells = np.zeros((12, 12, 12), np.float32)
    cells[2:10, 4:8, 3:6] = cells[2:4, 4:8, 6:9] = cells[6:8, 6:11, 4:6] = 1
    azimuths = jnp.deg2rad(5.0 * jnp.arange(72))
    poses = face_object(azimuths, jnp.full_like(azimuths, 0.26))
    see = functools.partial(project_volume, cells, grid=VoxelGrid(24))
    seen = jax.jit(lambda q: jax.lax.map(lambda one: see(one).silhouette, q))(poses)
    missed, hit = jnp.sum(seen, axis=(1, 2)), jnp.einsum("aij,bij->ab", seen, seen)
    # Row a: the masks of azimuth a, compared with what is seen from each azimuth.
    costs = missed[:, None] - hit + 0.2 * (missed[None] - hit)
    one = sum_event_costs(seen[7], seen[31], background=0.2)
    assert float(costs[31, 7]) == pytest.approx(float(one), rel=1e-4)
    away = np.argmin(costs, axis=1) - np.arange(72)
    assert np.abs((away + 36) % 72 - 36).max() <= 1


def test_the_baseline_is_a_moving_average_from_zero():
    first = sampling.update_baseline(jnp.zeros(()), jnp.array([2.0, 4.0]))
    second = sampling.update_baseline(first, jnp.array([1.0, 1.0]))
    assert float(first) == pytest.approx(0.05 * 3)
    assert float(second) == pytest.approx(0.95 * 0.15 + 0.05)


@pytest.fixture(scope="module")
def judging():
    """A network with a judge, its parameters, and how the judge is called."""
    network = ShapePoseNetwork(
        num_points=4,
        candidates=2,
        channels=2,
        hidden=8,
        shape_hidden=8,
        num_classes=2,
        viewpoints=(-20.0, 40.0),
        judges_poses=True,
    )
    params = network.init(jax.random.key(0), jnp.zeros((1, 16, 16, 3)))

    def judge(params, poses, key):
        keys = jax.random.split(key, poses.shape[0])
        return judge_poses(params, poses, keys, network=network)

    return params, jax.jit(judge)


def test_the_judge_learns_nothing_for_the_poses_and_they_nothing_for_it(judging):
    params, judge = judging
    poses = jax.random.normal(jax.random.key(2), (3, 2, 4))
    key = jax.random.key(3)
    by_params = jax.grad(lambda p: jnp.sum(judge(p, poses, key)[0]))(params)
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(by_params))
    by_poses = jax.grad(lambda q: judge(params, q, key)[1])(poses)
    assert not np.any(by_poses)
    assert np.any(jax.grad(lambda q: jnp.sum(judge(params, q, key)[0]))(poses))
    own = jax.grad(lambda p: judge(p, poses, key)[1])(params)["params"]["judge"]
    assert all(np.any(leaf) for leaf in jax.tree.leaves(own))


def test_the_prior_moves_a_collapsed_distribution(judging):
    """Azimuths that all lie within a few degrees spread around the object."""
    params, judge = judging
    angles = 0.05 * jax.random.normal(jax.random.key(5), (64,))
    optimizer = optax.adam(0.02)
    learned = (params["params"]["judge"], angles)
    state = optimizer.init(learned)

    def compare(learned, key):
        weights, azimuths = learned
        poses = face_object(azimuths, jnp.full_like(azimuths, 0.17))
        whole = {"params": params["params"] | {"judge": weights}}
        unlikely, loss = judge(whole, poses.reshape(16, 4, 4), key)
        return jnp.sum(unlikely) / 8 + loss

    @jax.jit
    def step(learned, state, key):
        slopes = jax.grad(compare)(learned, key)
        updates, state = optimizer.update(slopes, state)
        return optax.apply_updates(learned, updates), state

    def concentrate(azimuths):
        """1 where all agree, 0 of a uniform distribution."""
        return float(jnp.abs(jnp.mean(jnp.exp(1j * azimuths))))

    assert concentrate(angles) > 0.99
    for key in jax.random.split(jax.random.key(6), 600):
        learned, state = step(learned, state, key)
    assert concentrate(learned[1]) < 0.6


def test_a_step_learns_shape_poses_probabilities_and_judge():
    config = mvc_config()
    check(config)
    network, batch = make_network(config), make_batch()
    state = make_state(network, config)
    assert state.cost is not None and float(state.cost) == 0
    before = jax.tree.map(np.asarray, state.params["params"])
    new, metrics = make_step(network, config)(state, batch)
    assert new.cost is not None
    pixels = config.render.grid**2
    cost = metrics["reprojection"] + 0.1 * pixels * metrics["prior"]
    assert float(new.cost) == pytest.approx(0.05 * float(cost), rel=1e-5)
    assert "student" not in metrics and metrics["winners"].shape == (4,)
    for branch in ("encoder", "pose_encoder", "shape", "pose", "student", "judge"):
        pairs = zip(
            jax.tree.leaves(before[branch]),
            jax.tree.leaves(new.params["params"][branch]),
            strict=True,
        )
        assert any(np.any(old != np.asarray(late)) for old, late in pairs), branch


def test_poses_and_shapes_have_encoders_of_their_own():
    network = make_network(mvc_config())
    images = jax.random.normal(jax.random.key(0), (2, 16, 16, 3))
    params = network.init(jax.random.key(1), images)

    def read(part, method):
        def total(params):
            features = network.apply(params, images, method="encode")
            output = network.apply(params, features, method=method)
            return jnp.sum(output[part] ** 2)

        slopes = jax.jit(jax.grad(total))(params)["params"]
        return {
            name: any(np.any(leaf) for leaf in jax.tree.leaves(slopes[name]))
            for name in ("encoder", "pose_encoder")
        }

    assert read("cells", "predict_shape") == {"encoder": True, "pose_encoder": False}
    assert read("logits", "predict_pose") == {"encoder": False, "pose_encoder": True}


def test_one_head_cannot_be_drawn_of_several():
    config = build_config("car", "mvc")
    with pytest.raises(ValueError, match="config.pose.candidates must be above 1"):
        check(replace_fields(config, {"pose": {"candidates": 1}}))


def test_labelled_poses_have_no_judge():
    """What is learned from labels is not drawn: there is nothing to tell apart."""
    tiny = replace_fields(mvc_config(), {"pose": {"source": "labels", "candidates": 1}})
    network = make_network(tiny)
    assert "judge" not in make_state(network, tiny).params["params"]
