"""The hindsight choice: whose gradient it has, ties, order, turns, the coarse look."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data_trees import rotate
from tiny_runs import (
    draw_mask,
    make_batch,
    make_network,
    make_recipe,
    make_state,
    random_quaternions,
    tiny_config,
)

from dpc_jax import rotation_angle_deg
from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.learning.candidates import (
    Poses,
    compute_covariance,
    find_half_turns,
    turn_candidates,
)
from dpc_jax.learning.choice import hindsight
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.objective import compute_loss
from dpc_jax.learning.poses import source
from dpc_jax.learning.poses.source import compare_labels, compare_student
from dpc_jax.learning.recipe import Averages
from dpc_jax.learning.schedules import find_stage
from dpc_jax.learning.shapes.kind import Choice, View
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import downsample_images
from dpc_jax.measure.stability import oracles
from dpc_jax.render import Camera, VoxelGrid, project

CAMERA = Camera()
SIGMA = 0.6  # voxels


@pytest.fixture(scope="module")
def scene():
    """A lopsided cloud, candidates none of which is right, and a view of the cloud."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (30, 3)) * [0.8, 0.4, 0.2] + [0.05, 0.02, 0]
    target = draw_mask(points, random_quaternions(9)) / 255.0
    return {
        "points": jnp.array(points),
        "mass": jnp.array(0.7),
        "candidates": jnp.array(random_quaternions(1, 6)),
        "target": downsample_images(jnp.array(target * 255), 8),
    }


def render_losses(points, mass, candidates, target, *, sigma=SIGMA):
    """Loss of each candidate, in the plainest way."""
    is_covariance = jnp.ndim(sigma) == 3
    sizes = {"covariance" if is_covariance else "sigma": sigma, "scale": mass}
    grid = VoxelGrid(target.shape[0])
    images = jax.vmap(lambda q: project(points, q, grid=grid, **sizes).silhouette)(
        candidates
    )
    return jnp.sum((images - target[None]) ** 2, axis=(1, 2))


find_losses = jax.jit(render_losses)
OPTIONS = ("choice_points", "choice_top", "renders_at_once")


@functools.partial(jax.jit, static_argnames=OPTIONS)
def choose(scene, **static):
    return hindsight.choose_candidate(**scene, sigma=SIGMA, camera=CAMERA, **static)


def test_permuting_the_candidates_permutes_the_winner_and_of_equal_ones_the_first_wins(
    scene,
):
    winner = choose(scene)
    losses = np.asarray(find_losses(**scene))
    assert len(np.unique(losses)) == 6 and winner == np.argmin(losses)
    order = np.random.default_rng(0).permutation(6)
    permuted = choose(scene | {"candidates": scene["candidates"][order]})
    assert permuted.shape == () and order[permuted] == winner
    best = scene["candidates"][winner]
    # The same rotation five times, once with the other sign: equal losses.
    copies = jnp.stack([best, best, -best, best, 2 * best])
    alike = scene | {"candidates": copies}
    losses = find_losses(**alike)
    # 2q is normalised to q exactly: powers of two do not round.
    np.testing.assert_array_equal(losses, losses[0])
    assert choose(alike) == 0


# Behind the camera, beside the image, beyond the volume.
FAR = jnp.array([[0.0, 0, -3], [2, 0, 0], [0, -2, 0], [0, 0, 0.8]])


def splat_plainly(points, mass, candidate, *, side, sigma):
    """Optical depth [side, side] of the points in sight, in extended precision."""
    shape, pose = (side, side, 1), np.asarray(candidate, np.longdouble)
    places, is_inside = oracles.place(np.asarray(points, float), pose, shape=shape)
    places[:, 2] = 0  # all depths together
    depth = oracles.splat(places, mass * is_inside, shape)[..., 0]
    cells = np.arange(side)
    kernel = oracles.weigh(cells, cells[:, None], sigma)
    return kernel @ depth @ kernel


@pytest.mark.parametrize("count", [34, 7])
def test_an_image_ranks_by_the_optical_depth_of_splatted_points_in_sight(scene, count):
    points = jnp.concatenate([FAR[:2], scene["points"], FAR[2:]])

    @jax.jit
    def rank(points, mass, candidates, target):
        scene = {"points": points, "mass": mass, "sigma": jnp.array(SIGMA)}
        view, how = View(candidates, CAMERA, 8), Choice(count, 0, None)
        return Points.rank(scene, view, target, how)

    found = rank(**scene | {"points": points})
    points, mass = points[:count], float(scene["mass"]) * (34 / count)
    for candidate, loss in zip(scene["candidates"], found, strict=True):
        depth = splat_plainly(points, mass, candidate, side=8, sigma=SIGMA)
        expected = np.sum((1 - np.exp(-depth) - np.asarray(scene["target"])) ** 2)
        # Rounding of float32 in some thirty points' places and weights.
        assert float(loss) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.parametrize(
    "own", [{"mass": (30,)}, {"sigma": (30,)}, {"mass": (30,), "sigma": (30, 3, 3)}]
)
def test_points_of_own_mass_or_size_are_not_ranked_but_compared_exactly(scene, own):
    rng = np.random.default_rng(3)
    sizes = {"sigma": jnp.array(SIGMA)}
    for name, shape in own.items():
        sizes[name] = jnp.array(rng.uniform(0.1, 1.5, shape))
    if sizes["sigma"].ndim == 3:
        sizes["sigma"] = jnp.eye(3)[None] * sizes["sigma"]
    given = scene | sizes
    found = hindsight.choose_candidate(**given, camera=CAMERA, choice_points=10)
    losses = jax.jit(render_losses)(**given)
    assert found == jnp.argmin(losses)


def test_half_turns_are_unit_turns_by_180_degrees_about_the_principal_axes():
    axes = rotate(random_quaternions(4))  # columns
    rng = np.random.default_rng(0)
    points = (rng.normal(size=(500, 3)) * [1, 2, 3]) @ axes.T + [5, 6, 7]
    compute = jax.vmap(compute_covariance, axis_name=AXIS)
    (covariance,) = compute(jnp.array(points[None], jnp.float32))
    np.testing.assert_allclose(
        covariance, np.cov(points.T, bias=True), rtol=1e-4, atol=1e-4
    )
    turns = np.asarray(find_half_turns(covariance))
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-6)
    np.testing.assert_array_equal(turns[0], [1, 0, 0, 0])
    _, principal = np.linalg.eigh(np.cov(points.T))
    for turn, axis in zip(turns[1:], principal.T, strict=True):
        # 180° about a: 2aaᵀ - I. The eigenvectors of a float32 covariance with gaps of
        # order one are good to some 1e-6.
        expected = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(rotate(turn), expected, atol=1e-4)


@pytest.mark.parametrize("axes", [(0, 0, 0), (1, 1, 1), (1, 0, 0)])
def test_half_turns_of_a_cloud_without_distinct_axes_are_still_half_turns(axes):
    turns = np.asarray(find_half_turns(jnp.diag(jnp.array(axes, float))))
    assert np.all(turns[1:, 0] == 0)
    np.testing.assert_allclose(turns @ turns.T, np.eye(4), atol=1e-6)


# The training objective against the plain minimum.


def plain_objective(params, batch, *, network, config):
    """Mean over views of min over K, every candidate rendered with its gradient."""
    render = config.render
    views = batch["images"].reshape(-1, *batch["images"].shape[2:])
    output = network.apply(params, views / 127.5 - 1.0)
    per_object = batch["images"].shape[1]
    # The shape comes from the view before, of the same object.
    first = np.arange(len(views)) // per_object * per_object
    before = first + (np.arange(len(views)) - 1) % per_object
    all_losses = jax.vmap(
        functools.partial(render_losses, sigma=render.sigma_end * render.grid)
    )(
        output["points"][before],
        output["scale"][before],
        output["candidates"],
        downsample_images(batch["masks"].reshape(-1, 16, 16), config.render.grid),
    )
    losses = jnp.min(all_losses, axis=1)
    winners = jnp.argmin(all_losses, axis=1)
    teacher = jax.lax.stop_gradient(
        output["candidates"][np.arange(len(views)), winners]
    )
    cosine = jnp.sum(output["student"] * teacher, -1) / (
        jnp.linalg.norm(output["student"], axis=-1) * jnp.linalg.norm(teacher, axis=-1)
    )
    student = config.pose.student_weight * render.grid**2 * (1 - jnp.abs(cosine))
    return jnp.mean(losses) + jnp.mean(student)


def test_the_gradient_through_the_winner_alone_is_that_of_the_plain_minimum():
    """Without dropout."""
    config = tiny_config(sigma_start=0.1, sigma_end=0.1, keep_start=1.0, keep_end=1.0)
    network, batch = make_network(config), make_batch()
    params = make_state(network, config).params

    def compute(params):
        return compute_loss(
            params,
            batch,
            jax.random.split(jax.random.key(0), 2),
            jnp.asarray(0),
            Averages(jnp.zeros((3, 3))),
            recipe=make_recipe(config, network),
            stage=find_stage(0, config.render, steps=config.train.steps),
        )

    def compute_plainly(params):
        return plain_objective(params, batch, network=network, config=config)

    (loss, _), gradient = jax.jit(jax.value_and_grad(compute, has_aux=True))(params)
    expected_loss, expected = jax.jit(jax.value_and_grad(compute_plainly))(params)
    assert float(loss) == pytest.approx(float(expected_loss), rel=1e-5)
    # The same sums in another order: float32, against the largest entry of each leaf.
    for found, wanted in zip(
        jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True
    ):
        largest = float(jnp.max(jnp.abs(wanted)))
        np.testing.assert_allclose(found, wanted, atol=2e-5 * largest + 1e-7)
    norms = [float(jnp.linalg.norm(g)) for g in jax.tree.leaves(gradient)]
    assert np.median(norms) > 1e-3


@pytest.mark.parametrize(("compared", "later"), [(6, 3), (1, 1), (0, 0)])
def test_in_the_fine_grid_half_of_the_candidates_are_compared_exactly(
    monkeypatch, compared, later
):
    config = tiny_config(fine_grid=16, choice_top=compared)
    network, batch, counts = make_network(config), make_batch(), []

    def choose(*args, recipe):
        counts.append(recipe.pose.choice_top)
        return hindsight.choose_poses(*args, recipe=recipe)

    monkeypatch.setattr(source, "choose_poses", choose)
    for step in (0, config.train.steps - 1):
        compute = functools.partial(
            compute_loss,
            recipe=make_recipe(config, network),
            stage=find_stage(step, config.render, steps=config.train.steps),
        )
        keys = jax.random.split(jax.random.key(0), 2)
        averages = Averages(jnp.zeros((3, 3)))
        params = make_state(network, config).params
        jax.eval_shape(compute, params, batch, keys, jnp.asarray(step), averages)
    assert counts == [compared, later]


# Labels in place of images.


@pytest.mark.parametrize("sign", [1, -1])
def test_of_each_view_the_candidate_nearest_to_the_label_learns_and_is_selected(sign):
    config = tiny_config(source="labels", student="selects", student_weight=0.05)
    recipe = make_recipe(config)
    candidates, labels = random_quaternions(0, 4, 3), random_quaternions(1, 4)
    logits = jnp.asarray(np.random.default_rng(2).normal(size=(4, 3)))

    def compare(candidates):
        poses = Poses(candidates, None, logits)
        winners, terms = compare_labels(
            poses, jnp.asarray(sign * labels), recipe=recipe
        )
        terms |= compare_student(poses, winners, recipe=recipe)
        return terms["labels"].value, (winners, terms)

    differentiate = jax.value_and_grad(compare, has_aux=True)
    (_, (winners, terms)), gradient = differentiate(jnp.asarray(candidates))
    angles = np.deg2rad(rotation_angle_deg(candidates, labels[:, None]))
    nearest = angles.argmin(1)
    np.testing.assert_array_equal(winners.indices, nearest)
    np.testing.assert_array_equal(winners.poses, (sign * labels).astype(np.float32))
    loss, weight = terms["labels"]
    assert float(loss) == pytest.approx(angles.min(1).mean(), rel=1e-5)  # float32
    assert weight == 0.05 * config.render.grid**2
    learns = np.abs(gradient).max(-1) > 0
    np.testing.assert_array_equal(learns, np.eye(3, dtype=bool)[nearest])
    chosen = jax.nn.log_softmax(logits)[jnp.arange(4), nearest]
    expected = -float(chosen.mean())
    assert float(terms["student"].value) == pytest.approx(expected, rel=1e-5)


def test_half_turns_of_upright_viewpoints_stay_upright():
    turns = find_half_turns(jnp.eye(3), 2)
    assert turns.tolist() == [[1, 0, 0, 0], [0, 0, 0, 1]]
    heads = [look_at_rotation(1.0, 0.5), look_at_rotation(2.0, -0.2)]
    found = turn_candidates(jnp.array(matrix_to_quaternion(np.stack(heads))), turns)
    turned = [look_at_rotation(1.0 + np.pi, 0.5), look_at_rotation(2.0 + np.pi, -0.2)]
    expected = matrix_to_quaternion(np.stack(heads + turned))
    overlap = np.abs(np.sum(np.asarray(found) * expected, axis=1))
    assert np.allclose(overlap, 1, atol=1e-6)
