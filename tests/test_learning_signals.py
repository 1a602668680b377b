"""Signals beside the silhouette: what is compared, by which of them candidates win."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    make_batch,
    make_network,
    make_recipe,
    make_state,
    make_step,
    random_quaternions,
    tiny_config,
)

from dpc_jax.config import replace_fields
from dpc_jax.learning import signals
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.choice import batch_choice
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes.points import Points
from dpc_jax.render import Camera, Projection, VoxelGrid, project

pytestmark = pytest.mark.usefixtures("quickly")

DISTANCE, SIGMA = 2.0, 0.6
ALL = signals.Weights(0.5, 2.0, 0.3)
STAGE = Stage(kept_points=20, grid=8)


def make_views():
    """A batch of two objects, two views each, with depths where the masks cover."""
    rng = np.random.default_rng(4)
    batch = make_batch()
    depths = rng.uniform(1.7, 2.3, batch["masks"].shape)
    batch["depths"] = np.where(batch["masks"] > 0, depths, 0).astype(np.float32)
    return batch


def make_shapes():
    rng = np.random.default_rng(0)
    points = jnp.array(rng.uniform(-0.4, 0.4, (2, 20, 3)), jnp.float32)
    colors = jnp.array(rng.uniform(size=(2, 20, 3)), jnp.float32)
    mass = jnp.array([0.6, 0.9])
    return Points(points, points, colors, mass, mass, jnp.array(SIGMA))


def make_cameras():
    rng = np.random.default_rng(5)
    return Cameras(
        jnp.array(rng.uniform(-0.1, 0.1, (2, 2, 3)), jnp.float32),
        jnp.array(rng.uniform(1.5, 2.2, (2, 2)), jnp.float32),
    )


def average_plainly(image, side):
    """Means over blocks of an image [S, S, ...], one pixel after the other."""
    step = image.shape[0] // side
    return np.array(
        [
            [
                image[i * step :][:step, j * step :][:, :step].mean(axis=(0, 1))
                for j in range(side)
            ]
            for i in range(side)
        ]
    )


def find_costs(share, mixed):
    """What it costs that a ray ends in a cell, [D, D, 8], and that it misses."""
    places = DISTANCE - 0.5 + (np.arange(8) + 0.5) / 8
    costs = np.zeros((*share.shape, 8))
    for row, col in np.ndindex(*share.shape):
        if share[row, col] > 0:
            depth = 2.5 + (mixed[row, col] - 2.5) / share[row, col]
            before, behind = depth - 2 / 8 - places, places - depth
            beyond = np.maximum(before, behind)
            costs[row, col] = share[row, col] * np.where(beyond > 0, beyond, 0)
    return costs


def compute_plainly(batch, row, place, weights, rendered):
    """The loss of one view, in float64 from the arrays of the data set."""
    mask = batch["masks"][row, place] / 255.0
    depth = batch["depths"][row, place]
    mixed = np.where(mask > 0, mask * depth + (1 - mask) * 2.5, 2.5)
    targets = (mask, mixed, batch["images"][row, place] / 255.0)
    share, mixed, color = (average_plainly(target, 8) for target in targets)
    silhouette, ends, rgb = (np.asarray(image, np.float64) for image in rendered)
    losses = (
        np.sum((silhouette - share) ** 2),
        np.sum(ends * find_costs(share, mixed)),
        np.sum((rgb - color) ** 2),
    )
    return sum(w * loss for w, loss in zip(weights[:3], losses, strict=True))


def differentiate_plainly(batch, rendered):
    """Derivatives of the mean of `compute_plainly` by the rendered images."""
    silhouette, ends, color = (np.asarray(image, np.float64) for image in rendered)
    mask = batch["masks"] / 255.0
    shrink = np.vectorize(
        lambda image: average_plainly(image, 8), signature="(s,s)->(d,d)"
    )
    share = shrink(mask)
    mixed = 2.5 + shrink(mask * (batch["depths"] - 2.5))
    costs = [find_costs(share[at], mixed[at]) for at in np.ndindex(2, 2)]
    images = np.moveaxis(batch["images"] / 255.0, -1, 2)
    slopes = (
        2 * ALL.silhouette * (silhouette - share),
        ALL.depth * np.reshape(costs, ends.shape),
        2 * ALL.color * (color - np.moveaxis(shrink(images), 2, -1)),
    )
    return tuple(jnp.asarray(slope / 4, jnp.float32) for slope in slopes)


def render_plainly(points, mass, colors, rotation, translation, focal_length):
    image = project(
        points,
        rotation,
        sigma=SIGMA,
        scale=mass,
        colors=colors,
        translation=translation,
        camera=Camera(focal_length, DISTANCE),
        grid=VoxelGrid(8),
        signals=("silhouette", "termination", "color"),
    )
    return image.silhouette, image.termination, image.color


def test_a_target_depth_is_the_mean_over_all_samples_of_the_pixels():
    """Sample by sample: the depth of what is hit, and of the background of a miss."""
    rng = np.random.default_rng(0)
    hit = rng.random((16, 4, 16, 4)) < 0.4
    sampled = rng.uniform(1.5, 2.4, hit.shape)
    count = hit.sum(axis=(1, 3))
    # As the data are stored: the share that is covered, the mean depth of that.
    views = {
        "masks": np.rint(count * 255 / 16).astype(np.uint8),
        "depths": (sampled * hit).sum(axis=(1, 3)) / np.maximum(count, 1),
    }
    found = signals.make_targets(
        jax.tree.map(jnp.asarray, views), 8, signals=("depth",), distance=DISTANCE
    )
    every = np.where(hit, sampled, 2.5).reshape(64, 64)
    # A mask of 8 bits is off by 0.002 at most, depth from the background by up to 1.
    np.testing.assert_allclose(found["depth"], average_plainly(every, 8), atol=2e-3)
    np.testing.assert_allclose(
        found["measured"], average_plainly(hit.reshape(64, 64), 8), atol=2e-3
    )
    assert set(found) == {"depth", "measured"}


def compare_one_pixel(ends, share, depth, *, is_alone):
    """The cost of a pixel of the share whose depth is given; 8 cells of 1/8."""
    targets = {
        "depth": jnp.full((1, 1), share * depth + (1 - share) * 2.5),
        "measured": jnp.full((1, 1), share),
    }
    image = Projection(termination=jnp.asarray(ends, jnp.float32).reshape(1, 1, 8))
    camera = Camera(distance=DISTANCE)
    return float(
        signals.compare_depths(image, targets, camera=camera, is_alone=is_alone)
    )


@pytest.mark.parametrize("hit, share", [(1.0, 1.0), (0.4, 1.0), (0.4, 0.7)])
def test_beside_silhouettes_a_transparent_render_at_the_right_depth_costs_nothing(
    hit, share
):
    """Whatever the share of the pixel that is hit: only its depth is compared."""
    ends = hit * np.eye(8)[3]  # the cell at 1.9375
    right, alone = (
        compare_one_pixel(ends, share, 1.9375, is_alone=is_alone)
        for is_alone in (False, True)
    )
    assert right == 0
    # Two cells before the surface are free, none behind it.
    for depth, cells in ((2.4375, 2), (2.1875, 0), (1.6875, 2)):
        wrong = compare_one_pixel(ends, share, depth, is_alone=False)
        assert wrong == pytest.approx(share * hit * cells / 8, rel=1e-5, abs=1e-7)
    # Alone: where rays hit more or less than is there.
    assert alone == pytest.approx(((hit - share) * 0.5625) ** 2, abs=1e-6)


def test_half_too_near_and_half_too_far_is_not_the_right_depth():
    """Though it is right in the mean."""
    ends = [0, 0.5, 0, 0, 0, 0.5, 0, 0]
    cost = compare_one_pixel(ends, 1.0, 1.9375, is_alone=False)
    assert cost == pytest.approx(1 / 8, rel=1e-5)  # two cells before are free


def test_a_depth_that_was_not_measured_counts_as_background():
    views = {"masks": jnp.full((8, 8), 255, jnp.uint8), "depths": jnp.zeros((8, 8))}
    found = signals.make_targets(views, 8, signals=("depth",), distance=DISTANCE)
    np.testing.assert_array_equal(found["depth"], 2.5)


def test_all_signals_and_own_cameras_have_the_loss_and_gradient_of_plain_renders():
    config = tiny_config(
        silhouette_weight=0.5, depth_weight=2.0, color_weight=0.3, renders_at_once=1
    )
    shapes, batch, cameras = make_shapes(), make_views(), make_cameras()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)

    def compare(points, colors, cameras):
        seen = dataclasses.replace(shapes, kept=points, colors=colors)
        sections = {"recipe": make_recipe(config), "stage": STAGE}
        total, terms, _ = compare_winners(
            seen, rotations, batch, cameras=cameras, **sections
        )
        return total, terms

    arguments = shapes.kept, shapes.colors, cameras
    call = jax.jit(jax.value_and_grad(compare, (0, 1, 2), has_aux=True))
    (total, terms), found = call(*arguments)

    def render_all(points, colors, cameras):
        views = jax.vmap(render_plainly, (None, None, None, 0, 0, 0))
        return jax.vmap(views)(
            points,
            shapes.mass,
            colors,
            rotations,
            cameras.translations,
            cameras.focal_lengths,
        )

    rendered, pull = jax.vjp(jax.jit(render_all), *arguments)
    expected = np.mean(
        [
            compute_plainly(
                batch, row, place, ALL, [image[row, place] for image in rendered]
            )
            for row, place in np.ndindex(2, 2)
        ]
    )
    # float32 sums of 64 pixels.
    assert float(total) == pytest.approx(expected, rel=1e-5)
    assert set(terms) == {"reprojection", "depth", "color"}
    weighted = zip(ALL[:3], ("reprojection", "depth", "color"), strict=True)
    assert float(total) == pytest.approx(sum(w * float(terms[n]) for w, n in weighted))

    expected_slopes = differentiate_plainly(batch, rendered)
    for ours, theirs in zip(
        jax.tree.leaves(found), jax.tree.leaves(pull(expected_slopes)), strict=True
    ):
        # The same float32 sums in another order, against the largest entry.
        limit = 2e-5 * float(jnp.max(jnp.abs(theirs))) + 1e-7
        assert limit > 2e-7  # there is a gradient
        np.testing.assert_allclose(ours, theirs, atol=limit)


@pytest.mark.parametrize("rank", [{}, {"choice_points": 8}])
def test_with_all_signals_the_candidate_of_the_smallest_weighted_loss_wins(rank):
    mixed = signals.Weights(0.05, 2.0, 1.0)
    weights = {"silhouette_weight": 0.05, "depth_weight": 2.0, "color_weight": 1.0}
    how = {"choice_top": 6, "renders_at_once": 1, **rank}
    shapes, batch, cameras = make_shapes(), make_views(), make_cameras()
    assert shapes.colors is not None
    assert cameras.translations is not None and cameras.focal_lengths is not None
    candidates = jnp.array(random_quaternions(10, 4 * 6), jnp.float32).reshape(4, 6, 4)
    found = {}
    for choice in ("silhouette", "all"):
        config = tiny_config(choice_signals=choice, **weights, **how)
        choose = functools.partial(
            batch_choice.choose_poses, recipe=make_recipe(config)
        )
        winners = jax.jit(choose)(shapes, candidates, batch, cameras=cameras)
        found[choice] = np.asarray(winners.indices)

    render = jax.jit(jax.vmap(render_plainly, (None, None, None, 0, None, None)))
    for row, place in np.ndindex(2, 2):
        own = cameras.translations[row, place], cameras.focal_lengths[row, place]
        kept, mass, colors = shapes.kept[row], shapes.mass[row], shapes.colors[row]
        images = render(kept, mass, colors, candidates[2 * row + place], *own)
        for choice, weights in (("silhouette", (1, 0, 0)), ("all", mixed)):
            losses = [
                compute_plainly(batch, row, place, weights, [i[k] for i in images])
                for k in range(6)
            ]
            assert found[choice][row, place] == np.argmin(losses)
    assert (found["silhouette"] != found["all"]).any()


@pytest.fixture(scope="module")
def learned():
    """A run that learns depth alone, and the cameras, with an ensemble."""
    config = tiny_config(
        silhouette_weight=0.0,
        depth_weight=1.0,
        translation=True,
        choice_signals="all",
    )
    # The camera has a field of that name too.
    config = replace_fields(config, {"pose": {"focal_length": True}})
    network = make_network(config)
    return make_state(network, config), make_step(network, config)


def test_depth_alone_reaches_shape_poses_and_cameras(learned):
    state, step = learned
    batch = make_views()
    _, metrics = step(jax.tree.map(jnp.copy, state), batch)
    assert metrics["depth"] > 0 and "reprojection" not in metrics
    norms = metrics["gradient_norms"]
    assert set(norms) >= {"shape", "pose", "translation", "focal"}
    assert all(float(norm) > 0 for norm in norms.values())


def test_what_is_off_has_no_parameters_is_not_read_and_not_computed():
    config = tiny_config()
    plain = make_network(config)
    params = jax.eval_shape(plain.init, jax.random.key(0), jnp.zeros((1, 16, 16, 3)))[
        "params"
    ]
    assert set(params) == {"encoder", "shape", "pose", "student"}
    assert signals.list_extras(config) == ()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)

    def trace(**changes):
        recipe = make_recipe(tiny_config(**changes), plain)
        call = functools.partial(compare_winners, recipe=recipe, stage=STAGE)
        return str(jax.make_jaxpr(call)(make_shapes(), rotations, make_views()))

    # The probabilities along a ray are a running product; a silhouette needs none.
    assert "cumprod" not in trace()
    assert "cumprod" in trace(depth_weight=0.1)


def test_known_cameras_come_from_the_data_where_they_are_not_learned():
    def list_extras(**changes):
        config = tiny_config(offset=0.05, focal_spread=0.1, **changes)
        return signals.list_extras(config)

    assert list_extras(source="given") == ("translations", "focal_lengths")
    assert list_extras(source="given", translation=True) == ("focal_lengths",)
    assert list_extras() == ()
    assert list_extras(depth_weight=0.1) == ("depths",)
