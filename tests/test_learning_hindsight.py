"""The hindsight choice: whose gradient it has, ties, order, turns, the coarse look."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    draw_mask,
    make_batch,
    make_network,
    make_recipe,
    make_state,
    random_quaternions,
    rotation_matrix,
    tiny_config,
)

from dpc_jax.learning import half_turns
from dpc_jax.learning.choice import batch_choice, hindsight
from dpc_jax.learning.choice.coarse_choice import compute_image_losses, place_candidates
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.objective import compute_loss
from dpc_jax.learning.recipe import Averages
from dpc_jax.learning.schedules import find_stage
from dpc_jax.learning.shapes.points import Points
from dpc_jax.render import Camera, VoxelGrid, project

pytestmark = pytest.mark.usefixtures("quickly")

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
    images = jax.vmap(
        lambda q: (
            project(
                points, q, sigma=sigma, scale=mass, grid=VoxelGrid(target.shape[0])
            ).silhouette
        )
    )(candidates)
    return jnp.sum((images - target[None]) ** 2, axis=(1, 2))


@jax.jit
def find_losses(points, mass, candidates, target, sigma=SIGMA):
    return render_losses(points, mass, candidates, target, sigma=sigma)


@functools.partial(
    jax.jit,
    static_argnames=(
        "choice_points",
        "choice_top",
        "renders_at_once",
    ),
)
def compute_choice(arrays, **static):
    return hindsight.choose_candidate(**arrays, sigma=SIGMA, camera=CAMERA, **static)


def choose(scene, *, candidates=None, **static):
    if candidates is not None:
        scene = scene | {"candidates": candidates}
    found = compute_choice(dict(scene), **static)
    assert found.shape == ()
    return int(found)


def test_the_candidate_of_the_smallest_loss_wins(scene):
    losses = np.asarray(find_losses(**scene))
    assert len(np.unique(losses)) == 6  # no ties in this scene
    assert choose(scene) == np.argmin(losses)


@pytest.mark.parametrize("renders_at_once", [0, 4])
def test_the_choice_does_not_depend_on_how_many_are_rendered_at_once(
    scene, renders_at_once
):
    for static in ({}, {"choice_points": 10, "choice_top": 2}):
        assert choose(scene, renders_at_once=renders_at_once, **static) == choose(
            scene, **static
        )


def test_permuting_the_candidates_permutes_the_winner(scene):
    winner = choose(scene)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(6)
        found = choose(scene, candidates=scene["candidates"][order])
        assert order[found] == winner


def test_of_equal_candidates_the_first_wins(scene):
    winner = scene["candidates"][choose(scene)]
    # The same rotation five times, once with the other sign: equal losses.
    copies = jnp.stack([winner, winner, -winner, winner, 2 * winner])
    losses = find_losses(**scene | {"candidates": copies})
    # 2q is normalised to q exactly: powers of two do not round.
    np.testing.assert_array_equal(losses, losses[0])
    assert choose(scene, candidates=copies) == 0


def splat_plainly(points, mass, candidate, *, side, sigma):
    """Optical depth of each pixel in float64, point by point: [side, side]."""
    points = np.asarray(points, float) @ rotation_matrix(np.asarray(candidate)).T
    cells = np.arange(side)
    kernel = np.exp(-0.5 * ((cells[:, None] - np.arange(-90, 91)) / sigma) ** 2)
    depth = np.zeros((181, 181))
    for x, y, z in points:
        ahead = z + CAMERA.distance
        places = [CAMERA.focal_length * v / ahead + 0.5 for v in (y, x)]
        assert all(0 <= place <= 1 for place in places) and abs(z) <= 0.5
        (row, r), (col, c) = (
            (int(np.floor(v)), v - np.floor(v))
            for v in (place * side - 0.5 for place in places)
        )
        weights = np.outer([1 - r, r], [1 - c, c])
        depth[90 + row : 92 + row, 90 + col : 92 + col] += mass * weights
    # Points at the rim lose what falls on pixels outside.
    depth[:90], depth[90 + side :] = 0, 0
    depth[:, :90], depth[:, 90 + side :] = 0, 0
    kernel /= np.exp(-0.5 * (np.arange(-90, 91) / sigma) ** 2).sum()
    return kernel @ depth @ kernel.T


@pytest.mark.parametrize("count", [30, 7])
def test_an_image_ranks_by_the_optical_depth_of_splatted_points(scene, count):
    places = place_candidates(
        scene["points"][:30],
        scene["candidates"],
        side=8,
        camera=CAMERA,
        choice_points=count,
    )
    found = compute_image_losses(
        places, scene["mass"], scene["target"], sigma=jnp.array(SIGMA)
    )
    target = np.asarray(scene["target"])
    for candidate, loss in zip(scene["candidates"], found, strict=True):
        depth = splat_plainly(
            scene["points"][:count],
            float(scene["mass"]) * (30 / count),
            candidate,
            side=8,
            sigma=SIGMA,
        )
        expected = np.sum((1 - np.exp(-depth) - target) ** 2)
        # Rounding of float32 in some thirty points' places and weights.
        assert float(loss) == pytest.approx(expected, rel=1e-4)


def test_points_out_of_the_image_or_behind_the_camera_are_not_seen(scene):
    far = jnp.array([[0.0, 0, -3], [2, 0, 0], [0, -2, 0], [0, 0, 0.8]])
    turn = jnp.array([[1.0, 0, 0, 0]])
    rank = functools.partial(place_candidates, side=8, camera=CAMERA, choice_points=0)
    losses = [
        compute_image_losses(
            rank(points, turn)._replace(share=jnp.array(1.0)),
            scene["mass"],
            scene["target"],
            sigma=jnp.array(SIGMA),
        )
        for points in (
            scene["points"][:20],
            jnp.concatenate([scene["points"][:20], far]),
        )
    ]
    np.testing.assert_array_equal(losses[0], losses[1])


@pytest.mark.parametrize("renders_at_once", [0, 1, 4])
def test_of_those_that_an_image_ranks_first_the_exact_best_wins(scene, renders_at_once):
    image = {"choice_points": 100, "renders_at_once": renders_at_once}
    assert choose(scene, choice_top=6, **image) == choose(scene)
    first = choose(scene, choice_top=0, **image)
    assert first == choose(scene, choice_top=1, **image)
    losses = np.asarray(find_losses(**scene))
    assert losses[choose(scene, choice_top=3, **image)] <= losses[first]


def test_the_choice_of_a_batch_is_that_of_each_view(scene):
    rng = np.random.default_rng(2)
    kept = jnp.array(rng.uniform(-0.4, 0.4, (2, 30, 3)), jnp.float32)
    mass = jnp.array([0.7, 0.5])
    shapes = Points(kept, kept, None, mass, mass, jnp.array(SIGMA))
    candidates = jnp.array(random_quaternions(3, 4 * 6)).reshape(4, 6, 4)
    masks = jnp.array(rng.integers(0, 256, (2, 2, 16, 16)), jnp.uint8)
    settings = {"choice_points": 12, "choice_top": 2}
    config = tiny_config(**settings, renders_at_once=1)
    winners = jax.jit(
        functools.partial(batch_choice.choose_poses, recipe=make_recipe(config))
    )(shapes, candidates, {"masks": masks})
    targets = downsample_images(masks, 8).reshape(4, 8, 8)
    for view in range(4):
        alone = {
            "points": kept[view // 2],
            "mass": mass[view // 2],
            "candidates": candidates[view],
            "target": targets[view],
        }
        assert choose(alone, **settings) == winners.indices.reshape(-1)[view]


def test_half_turns_are_unit_turns_by_180_degrees_about_the_principal_axes():
    axes = rotation_matrix(random_quaternions(4))  # columns
    rng = np.random.default_rng(0)
    points = (rng.normal(size=(500, 3)) * [1, 2, 3]) @ axes.T + [5, 6, 7]
    covariance = half_turns.compute_covariance(jnp.array(points, jnp.float32))
    np.testing.assert_allclose(
        covariance, np.cov(points.T, bias=True), rtol=1e-4, atol=1e-4
    )
    turns = np.asarray(half_turns.find_half_turns(covariance))
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-6)
    np.testing.assert_array_equal(turns[0], [1, 0, 0, 0])
    _, principal = np.linalg.eigh(np.cov(points.T))
    for turn, axis in zip(turns[1:], principal.T, strict=True):
        # 180° about a: 2aaᵀ - I. The eigenvectors of a float32 covariance with gaps of
        # order one are good to some 1e-6.
        expected = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(rotation_matrix(turn), expected, atol=1e-4)


@pytest.mark.parametrize(
    "covariance", [np.zeros((3, 3)), np.eye(3), np.diag([1, 0, 0])]
)
def test_half_turns_of_a_cloud_without_distinct_axes_are_still_half_turns(covariance):
    turns = np.asarray(half_turns.find_half_turns(jnp.array(covariance, jnp.float32)))
    assert np.all(turns[1:, 0] == 0)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-6)
    for i in range(4):
        for j in range(i):
            assert abs(turns[i] @ turns[j]) < 1e-6


def test_turned_candidate_i_is_head_i_mod_k_after_a_turn_of_the_object():
    candidates, turns = random_quaternions(1, 5), random_quaternions(2, 4)
    turned = half_turns.turn_candidates(jnp.array(candidates), jnp.array(turns))
    assert turned.shape == (20, 4)
    for i, q in enumerate(turned):
        expected = rotation_matrix(candidates[i % 5]) @ rotation_matrix(turns[i // 5])
        np.testing.assert_allclose(rotation_matrix(q), expected, atol=1e-5)


# The training objective against the plain minimum.


def plain_objective(params, batch, *, network, config):
    """Mean over views of min over K, every candidate rendered with its gradient."""
    render = config.render
    views = batch["images"].reshape(-1, *batch["images"].shape[2:])
    output = network.apply(params, views / 127.5 - 1.0)
    per_object = batch["images"].shape[1]
    # The shape comes from the object's first view.
    first = np.arange(len(views)) // per_object * per_object
    all_losses = jax.vmap(
        functools.partial(render_losses, sigma=render.sigma_end * render.grid)
    )(
        output["points"][first],
        output["scale"][first],
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


@pytest.fixture(scope="module")
def objective():
    """The objective and its gradient, without dropout; compiled once."""
    config = tiny_config(sigma_start=0.1, sigma_end=0.1, keep_start=1.0)
    network = make_network(config)

    @jax.jit
    def differentiate(params, batch):
        return jax.value_and_grad(compute_loss, has_aux=True)(
            params,
            batch,
            jax.random.split(jax.random.key(0), 2),
            jnp.asarray(0),
            Averages(jnp.zeros((3, 3))),
            recipe=make_recipe(config, network),
            stage=find_stage(0, config.render, steps=config.train.steps),
        )

    return differentiate, network, config, make_state(network, config).params


def test_the_gradient_through_the_winner_alone_is_that_of_the_plain_minimum(objective):
    differentiate, network, config, params = objective
    batch = make_batch()
    (loss, _), gradient = differentiate(params, batch)
    expected_loss, expected = jax.jit(
        jax.value_and_grad(
            lambda p: plain_objective(p, batch, network=network, config=config)
        )
    )(params)
    assert float(loss) == pytest.approx(float(expected_loss), rel=1e-5)
    # The same sums in another order: float32, against the largest entry of each leaf.
    for found, wanted in zip(
        jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True
    ):
        largest = float(jnp.max(jnp.abs(wanted)))
        np.testing.assert_allclose(found, wanted, atol=2e-5 * largest + 1e-7)
    norms = [float(jnp.linalg.norm(g)) for g in jax.tree.leaves(gradient)]
    assert np.median(norms) > 1e-3


def test_heads_that_never_win_get_no_gradient_and_those_that_win_get_one(objective):
    differentiate, _, config, params = objective
    for seed in range(3):
        (_, (metrics, _)), gradient = differentiate(params, make_batch(seed=seed))
        winners = np.asarray(metrics["winners"])
        assert winners.shape == (4,)
        heads = gradient["params"]["pose"]["heads"]["Dense_2"]["kernel"]
        norms = np.linalg.norm(np.asarray(heads).reshape(3, -1), axis=-1)
        np.testing.assert_array_equal(norms > 0, np.isin(np.arange(3), winners))


def test_equal_heads_tie_on_every_view_whatever_points_were_dropped(objective):
    # Candidates rendered with different subsets would differ: with one subset for all
    # of them the tie is exact, and the first head has the whole gradient.
    _, network, _, params = objective
    network = network.clone(spreads=False)
    config = tiny_config(keep_start=0.3, keep_levels=1, keep_end=0.3)
    heads = params["params"]["pose"]["heads"]
    equal = jax.tree.map(lambda a: jnp.broadcast_to(a[:1], a.shape), heads)
    params = {
        "params": params["params"]
        | {"pose": params["params"]["pose"] | {"heads": equal}}
    }

    @jax.jit
    def differentiate(key):
        return jax.grad(compute_loss, has_aux=True)(
            params,
            make_batch(),
            jax.random.split(key, 2),
            jnp.asarray(0),
            Averages(jnp.zeros((3, 3))),
            recipe=make_recipe(config, network),
            stage=find_stage(0, config.render, steps=config.train.steps),
        )

    for seed in range(3):
        gradient, (metrics, _) = differentiate(jax.random.key(seed))
        np.testing.assert_array_equal(metrics["winners"], 0)
        kernel = gradient["params"]["pose"]["heads"]["Dense_2"]["kernel"]
        assert np.linalg.norm(kernel[0]) > 0
        np.testing.assert_array_equal(kernel[1:], 0)
