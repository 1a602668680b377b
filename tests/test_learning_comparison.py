"""Eq. 1 and the choice of poses, for each kind of shape against plain renders."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data_trees import rotate
from tiny_runs import (
    make_batch,
    make_network,
    make_recipe,
    random_quaternions,
    tiny_config,
)

from dpc_jax.learning import batches, signals
from dpc_jax.learning.candidates import compute_covariance
from dpc_jax.learning.choice.hindsight import choose_poses
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes import points, voxels
from dpc_jax.learning.shapes.points import (
    Points,
    draw_order,
    measure_points,
    scale_sizes,
)
from dpc_jax.learning.shapes.voxels import Voxels
from dpc_jax.render import Camera, Projection, VoxelGrid, project, project_volume

DISTANCE, SIDE, COUNT, VIEWS = 2.0, 8, 12, 4
RENDERED = {"silhouette": "silhouette", "depth": "termination", "color": "color"}
ALL = {"silhouette_weight": 0.5, "depth_weight": 2.0, "color_weight": 0.3}


def as_float32(array):
    return jnp.asarray(array, jnp.float32)


def draw_head(kind):
    """What a head of learned sizes predicts for four images, by name."""
    rng = np.random.default_rng(0)
    columns = 3 if kind == "covariance" else 1
    shape = {
        "points": rng.uniform(-0.3, 0.3, (VIEWS, COUNT, 3)),
        "scale": rng.uniform(0.5, 0.9, VIEWS),
        "sizes": rng.uniform(0.08, 0.25, (VIEWS, COUNT, columns)),
    }
    if kind == "covariance":
        shape["turns"] = 2 * random_quaternions(4, VIEWS, COUNT)
    return jax.tree.map(as_float32, shape)


def make_shapes(kind):
    """A shape of a kind for each view, and the names of the fields that are learned."""
    rng = np.random.default_rng(0)
    if kind == "voxels":
        cells = as_float32(rng.uniform(0, 0.6, (VIEWS, 8, 8, 8)) ** 3)
        return Voxels(cells, as_float32(rng.uniform(size=(VIEWS, 8, 8, 8, 3)))), (
            "cells",
        )
    colors = as_float32(rng.uniform(size=(VIEWS, COUNT, 3)))
    if kind == "points":
        points = as_float32(rng.uniform(-0.4, 0.4, (VIEWS, COUNT, 3)))
        mass = jnp.array([0.6, 0.9, 0.7, 0.8])
        shapes = Points(points, points, colors, mass, mass, jnp.array(0.6))
        return shapes, ("kept", "mass", "colors")
    shape = draw_head(kind)
    size, mass = measure_points(shape, grid=SIDE)
    points = shape["points"]
    return Points(points, points, colors, mass, mass, size), ("kept", "mass", "sigma")


def make_views():
    """Four views with depths where the masks cover."""
    arrays = make_batch()
    batch = {n: arrays[n].reshape(VIEWS, *arrays[n].shape[2:])
             for n in ("images", "masks")}  # fmt: skip
    depths = np.random.default_rng(4).uniform(1.7, 2.3, batch["masks"].shape)
    batch["depths"] = np.where(batch["masks"] > 0, depths, 0).astype(np.float32)
    return batch


def make_cameras(are_own=True):
    rng = np.random.default_rng(5)
    cameras = {
        "translation": as_float32(rng.uniform(-0.1, 0.1, (VIEWS, 3))),
        "focal_length": as_float32(rng.uniform(1.5, 2.2, VIEWS)),
    }
    return cameras if are_own else {}


ROTATIONS = as_float32(random_quaternions(3, VIEWS))


def average_plainly(image, side):
    """Means over blocks of an image [S, S, ...]."""
    step = image.shape[0] // side
    blocks = image.reshape(side, step, side, step, *image.shape[2:])
    return blocks.mean(axis=(1, 3))


def find_targets(batch, at, side):
    """Covered share [D, D], costs of ends [D, D, D], colours [D, D, 3] of a view.

    A ray's end costs its distance from the true depth; two cells before it are free.
    """
    mask = batch["masks"][at] / 255.0
    mixed = np.where(mask > 0, mask * batch["depths"][at] + (1 - mask) * 2.5, 2.5)
    share, mixed, color = (
        average_plainly(a, side) for a in (mask, mixed, batch["images"][at] / 255.0)
    )
    places = DISTANCE - 0.5 + (np.arange(side) + 0.5) / side
    depth = 2.5 + (mixed - 2.5) / np.where(share > 0, share, 1)
    before = depth[..., None] - 2 / side - places
    beyond = np.maximum(before, places - depth[..., None])
    return share, share[..., None] * np.maximum(beyond, 0), color


def render_plainly(shapes, row, rotation, own, side, **options):
    """The images of a view of one object; sizes are those of a grid of `SIDE`."""
    camera = Camera(own.get("focal_length", 1.875), DISTANCE)
    options |= {"camera": camera, "grid": VoxelGrid(side)}
    options["translation"] = own.get("translation")
    if isinstance(shapes, Voxels):
        return project_volume(shapes.cells[row], rotation, **options)
    ratio = side / SIDE
    size = shapes.sigma if shapes.sigma.ndim == 0 else shapes.sigma[row]
    name = "covariance" if size.ndim == 3 else "sigma"
    return project(
        shapes.kept[row],
        rotation,
        scale=shapes.mass[row] * ratio**3,
        colors=shapes.colors[row],
        **{name: size * ratio},
        **options,
    )


def compare_plainly(shapes, view, side, config):
    """The weighted loss of one view: its object, pose, own camera and targets."""
    row, rotation, own, (share, costs, color) = view
    train = config.train
    weights = (train.silhouette_weight, train.depth_weight, train.color_weight)
    chosen = [n for n, w in zip(RENDERED, weights, strict=True) if w]
    options = {"signals": tuple(RENDERED[n] for n in chosen)}
    options["ray_rule"] = config.render.ray_rule
    image = render_plainly(shapes, row, rotation, own, side, **options)
    if not train.colors_move_points:
        still = dataclasses.replace(jax.lax.stop_gradient(shapes), colors=shapes.colors)
        still = still, row, jax.lax.stop_gradient(rotation), own, side
        color_alone = render_plainly(*still, **options).color
        image = dataclasses.replace(image, color=color_alone)
    total = 0.0
    for name, weight in zip(RENDERED, weights, strict=True):
        if not weight:
            continue
        seen, beside = getattr(image, RENDERED[name]), train.background_weight
        if name == "depth":
            loss = jnp.sum(seen * costs)
        elif name == "silhouette" and beside:
            loss = jnp.sum(share * (1 - seen) + beside * (1 - share) * seen)
        else:
            loss = jnp.sum((seen - (share if name == "silhouette" else color)) ** 2)
        total += weight * loss
    return total


def list_views(batch, rotations, cameras, side):
    """Arrays of the four views, as `compare_plainly` takes one of them."""
    targets = [find_targets(batch, at, side) for at in range(VIEWS)]
    targets = tuple(as_float32(np.stack(a)) for a in zip(*targets, strict=True))
    return jnp.arange(VIEWS), rotations, cameras, targets


# kind, side of the winners, whether views have cameras of their own, fields
CASES = {
    "all signals": ("points", 8, True, ALL),
    "colours that move no points, finer": (
        *("points", 16, False),
        {"color_weight": 0.3, "colors_move_points": False, "renders_at_once": 9},
    ),
    "covariances": ("covariance", 8, False, {}),
    "ptn": ("voxels", 8, False, {"shape": "voxels", "ray_rule": "maximum"}),
    "drc with depth": (
        *("voxels", 8, False),
        {"shape": "voxels", "background_weight": 0.2, "depth_weight": 2.0},
    ),
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow if case == "covariances" else ())
        for case in CASES
    ],
)
def test_winners_have_the_loss_and_the_gradient_of_plain_renders(case):
    kind, side, has_cameras, fields = CASES[case]
    config = tiny_config(**{"renders_at_once": 1} | fields)
    shapes, names = make_shapes(kind)
    batch, cameras = make_views(), make_cameras(has_cameras)
    sections = {"recipe": make_recipe(config), "stage": Stage(COUNT, side)}

    def compare(learned, rotations, cameras):
        seen = dataclasses.replace(shapes, **learned)
        views = {"rotation": rotations, **cameras}
        total, *rest = seen.compare(views, batch, **sections)
        return 3 * total, rest  # so that the cotangent is not one

    def sum_plainly(learned, rotations, cameras):
        seen = dataclasses.replace(shapes, **learned)
        views = list_views(batch, rotations, cameras, side)
        losses = jax.vmap(lambda v: compare_plainly(seen, v, side, config))(views)
        return 3 * jnp.mean(losses) / (side / SIDE) ** 2

    learned = {name: getattr(shapes, name) for name in names}
    places = (0, 1, 2)
    call = jax.jit(jax.value_and_grad(compare, places, has_aux=True))
    (total, (terms, costs)), found = call(learned, ROTATIONS, cameras)
    plain = jax.jit(jax.value_and_grad(sum_plainly, places))
    expected, slopes = plain(learned, ROTATIONS, cameras)
    # float32 sums of some hundred pixels.
    assert float(total) == pytest.approx(float(expected), rel=1e-5)
    assert 3 * float(jnp.mean(costs)) == pytest.approx(float(total), rel=1e-5)
    weights = sections["recipe"].weights
    weighted = [getattr(weights, n) * terms.pop(signals.LOSSES[n]) for n in RENDERED
                if getattr(weights, n)]  # fmt: skip
    assert not terms
    assert 3 * float(sum(weighted)) == pytest.approx(float(total), rel=1e-5)
    for ours, theirs in zip(
        jax.tree.leaves(found), jax.tree.leaves(slopes), strict=True
    ):
        # The same float32 sums in another order, against the largest entry.
        limit = 2e-5 * float(jnp.max(jnp.abs(theirs))) + 1e-6
        np.testing.assert_allclose(ours, theirs, atol=limit)
    assert any(np.abs(leaf).max() > 1e-2 for leaf in jax.tree.leaves(slopes[0]))


def test_winners_of_a_large_grid_are_rendered_in_the_blocks_of_their_stage(monkeypatch):
    rooms = set()

    def record(*arguments, max_blocks, **options):
        rooms.add(max_blocks)
        return project(*arguments, max_blocks=max_blocks, **options)

    monkeypatch.setattr(points, "project", record)
    shapes, _ = make_shapes("points")
    recipe, batch = make_recipe(tiny_config()), make_views()
    large = {"masks": batch["masks"].repeat(16, axis=1).repeat(16, axis=2)}
    compare = functools.partial(
        shapes.compare, recipe=recipe, stage=Stage(COUNT, 256, 99)
    )
    jax.eval_shape(compare, {"rotation": ROTATIONS}, large)
    assert rooms == {99}


MIXED = {"silhouette_weight": 0.05, "depth_weight": 2.0, "color_weight": 1.0}
CHOICES = {
    "exact": ("points", False, {}),
    "all signals": ("points", True, {"choice_top": 5, **MIXED}),
    "sigmas": ("sigma", False, {"choice_top": 5}),
    "cells": ("voxels", False, {"shape": "voxels"}),
}


@pytest.mark.parametrize("case", CHOICES)
def test_the_candidate_of_the_smallest_weighted_loss_wins(case, monkeypatch):
    """Where it passes the first look."""
    monkeypatch.setattr(voxels, "COARSE_SIDE", 4)
    kind, has_cameras, fields = CHOICES[case]
    config = tiny_config(renders_at_once=1, **fields)
    shapes, _ = make_shapes(kind)
    batch, cameras = make_views(), make_cameras(has_cameras)
    candidates = as_float32(random_quaternions(10, VIEWS, 6))
    choose = functools.partial(choose_poses, recipe=make_recipe(config))
    winners = jax.jit(choose)(shapes, candidates, batch, cameras)
    compared = tiny_config(**{**fields, "choice_top": 0})

    @jax.jit
    def compare_all(candidates):
        def compare(view):
            row, poses, own, targets = view
            return jax.lax.map(
                lambda q: compare_plainly(
                    shapes, (row, q, own, targets), SIDE, compared
                ),
                poses,
            )

        views = list_views(batch, candidates, cameras, SIDE)
        return jax.lax.map(compare, views)

    expected = np.argmin(compare_all(candidates), axis=1)
    np.testing.assert_array_equal(winners.indices, expected)
    chosen = np.asarray(candidates)[np.arange(VIEWS), expected]
    np.testing.assert_array_equal(winners.poses, chosen)


# Targets and costs.


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
    find = functools.partial(
        signals.make_targets, signals=("depth",), distance=DISTANCE
    )
    found = find(jax.tree.map(jnp.asarray, views), 8)
    every = np.where(hit, sampled, 2.5).reshape(64, 64)
    # A mask of 8 bits is off by 0.002 at most, depth from the background by up to 1.
    np.testing.assert_allclose(found["depth"], average_plainly(every, 8), atol=2e-3)
    share = average_plainly(hit.reshape(64, 64), 8)
    np.testing.assert_allclose(found["measured"], share, atol=2e-3)
    # A depth that was not measured counts as background.
    views = {"masks": jnp.full((8, 8), 255, jnp.uint8), "depths": jnp.zeros((8, 8))}
    np.testing.assert_array_equal(find(views, 8)["depth"], 2.5)


def test_spread_masks_are_as_wide_as_points_draw_a_solid():
    """40,000 points in a cylinder, seen along its axis: 5 of their mass on a pixel."""
    rng, side, radius, count = np.random.default_rng(0), 32, 0.25, 40_000
    away, angle = radius * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    along = rng.uniform(-0.45, 0.45, count)
    cloud = np.stack([away * np.cos(angle), away * np.sin(angle), along], axis=1)
    places = (np.arange(16 * side) + 0.5) / (16 * side) - 0.5
    is_hit = places[:, None] ** 2 + places**2 < radius**2
    mask = average_plainly(is_hit, side)
    drawn = project(
        jnp.asarray(cloud, jnp.float32),
        jnp.eye(3),
        sigma=0.01,
        scale=5 * mask.sum() / count,
        camera=Camera(1.0, 2.0, "orthographic"),
        grid=VoxelGrid(side),
    ).silhouette
    spread = signals.spread_masks(jnp.asarray(mask, jnp.float32))
    # Within its pixels a mask is not even, as it is taken to be.
    away = [np.abs(image - drawn).mean() for image in (spread, mask)]
    assert away[0] < away[1] / 2


@pytest.mark.parametrize("spreads", [False, True])
def test_points_alone_are_compared_with_spread_masks(spreads, monkeypatch):
    seen = []
    spread = signals.spread_masks
    monkeypatch.setattr(signals, "spread_masks", lambda m: seen.append(1) or spread(m))
    for name in ("points", "voxels"):
        recipe = make_recipe(tiny_config(spread_masks=spreads, shape=name))
        compare = functools.partial(
            make_shapes(name)[0].compare, recipe=recipe, stage=Stage(COUNT, SIDE)
        )
        jax.eval_shape(compare, {"rotation": ROTATIONS}, make_views())
    assert len(seen) == spreads


def compare_one_pixel(ends, share, depth, *, is_alone):
    """The cost of a pixel of the share whose depth is given; 8 cells of 1/8."""
    targets = {
        "depth": jnp.full((1, 1), share * depth + (1 - share) * 2.5),
        "measured": jnp.full((1, 1), share),
    }
    image = Projection(termination=as_float32(ends).reshape(1, 1, 8))
    compare = functools.partial(signals.compare_depths, is_alone=is_alone)
    return float(compare(image, targets, camera=Camera(distance=DISTANCE)))


@pytest.mark.parametrize("hit, share", [(1.0, 1.0), (0.4, 1.0), (0.4, 0.7)])
def test_beside_silhouettes_a_transparent_render_at_the_right_depth_costs_nothing(
    hit, share
):
    """Whatever the share of the pixel that is hit: only its depth is compared."""
    ends = hit * np.eye(8)[3]  # the cell at 1.9375
    assert compare_one_pixel(ends, share, 1.9375, is_alone=False) == 0
    # Alone: where rays hit more or less than is there.
    alone = compare_one_pixel(ends, share, 1.9375, is_alone=True)
    assert alone == pytest.approx(((hit - share) * 0.5625) ** 2, abs=1e-6)
    # Half too near and half too far is not right, though it is in the mean.
    spread = [0, 0.5 * hit, 0, 0, 0, 0.5 * hit, 0, 0]
    wrong = compare_one_pixel(spread, share, 1.9375, is_alone=False)
    assert wrong == pytest.approx(share * hit / 8, rel=1e-5)  # two before are free


@pytest.mark.parametrize(
    ("fields", "extras"),
    [
        ({"source": "given"}, ("translations", "focal_lengths")),
        ({"source": "given", "translation": True}, ("focal_lengths",)),
        ({}, ()),
        ({"depth_weight": 0.1}, ("depths",)),
    ],
)
def test_known_cameras_come_from_the_data_where_they_are_not_learned(fields, extras):
    config = tiny_config(offset=0.05, focal_spread=0.1, **fields)
    assert batches.list_extras(config) == extras


# Sizes, dropout, cells.


@pytest.mark.parametrize("kind", ["sigma", "covariance"])
def test_sizes_and_masses_are_those_of_the_paper(kind):
    shape = draw_head(kind)
    size, mass = measure_points(shape, grid=SIDE)
    for place in np.ndindex(VIEWS, COUNT):
        widths = SIDE * np.broadcast_to(np.asarray(shape["sizes"][place], float), 3)
        covariance = np.diag(widths**2)
        if kind == "covariance":
            turn = rotate(shape["turns"][place])
            covariance = turn @ covariance @ turn.T
            found = np.asarray(size[place])
        else:
            found = float(size[place]) ** 2 * np.eye(3)
        # Rounding of float32 in some ten operations.
        np.testing.assert_allclose(found, covariance, atol=1e-5)
        root = np.sqrt(np.linalg.det(covariance))
        peak = float(mass[place]) / ((2 * np.pi) ** 1.5 * root)
        assert peak == pytest.approx(float(shape["scale"][place[0]]), rel=1e-5)
    # A finer grid has the same Gaussians in smaller voxels.
    finer = measure_points(shape, grid=2 * SIDE)
    scaled = scale_sizes(size, mass, 2.0)
    for ours, theirs in zip(scaled, finer, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5)


def test_dropout_keeps_each_point_with_its_own_size_and_mass():
    config = tiny_config(source="given", num_points=COUNT, point_size="covariance")
    network = make_network(config)
    features = as_float32(np.random.default_rng(0).normal(size=(2, 12)))
    params = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, 16, 16, 3)))
    keys = jax.random.split(jax.random.key(1), 2)
    shape = network.apply(params, features, method="predict_shape")
    read = Points.read(shape, jnp.array(0.4), render=config.render)
    whole, half = read.drop(keys, COUNT), read.drop(keys, COUNT // 2)
    sizes, masses = measure_points(shape, grid=SIDE)
    for name, all_of_them in (("kept", shape["points"]), ("mass", masses),
                              ("sigma", sizes)):  # fmt: skip
        found = np.asarray(getattr(whole, name))
        # The first half of one random order of the points, which is that of the keys.
        np.testing.assert_array_equal(getattr(half, name), found[:, : COUNT // 2])
        for row in range(2):
            order = draw_order(keys[row], count=COUNT)
            np.testing.assert_array_equal(found[row], all_of_them[row][order])


def test_an_order_has_every_index_once_and_each_comes_first_equally_often():
    keys = jax.random.split(jax.random.key(0), 20_000)
    orders = np.asarray(jax.jit(jax.vmap(lambda key: draw_order(key, count=10)))(keys))
    np.testing.assert_array_equal(np.sort(orders)[::99], [np.arange(10)] * 203)
    for place in (0, 4, 9):
        counts = np.bincount(orders[:, place], minlength=10)
        # A binomial count of mean 2000 has a standard deviation of 42.
        np.testing.assert_allclose(counts, 2000, atol=5 * 42)


def test_half_turns_are_about_the_axes_of_what_is_filled():
    """A bar of full cells among empty ones: its length has nearly all variance."""
    cells = jnp.zeros((1, 8, 8, 8)).at[0, :, 3:5, 3:5].set(1.0)
    places, weights = Voxels(cells, None).find_places()
    # Uniform over 8 cells of 1/8, and over 2 of them.
    expected = np.diag([(8**2 - 1) / 12, 0.25, 0.25]) / 64
    compute = jax.vmap(compute_covariance, axis_name=AXIS)
    np.testing.assert_allclose(compute(places, weights)[0], expected, atol=1e-6)
