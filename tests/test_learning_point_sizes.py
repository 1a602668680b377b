"""Points of learned sizes: their masses, the winners' loss and the choice of poses."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    make_batch,
    make_recipe,
    random_quaternions,
    rotation_matrix,
    tiny_config,
)

from dpc_jax.learning import losses, point_sizes
from dpc_jax.learning.choice import hindsight
from dpc_jax.learning.choice.coarse_choice import compute_image_losses, place_candidates
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.predictions import predict_shapes
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes.points import Points
from dpc_jax.render import Camera, VoxelGrid, project
from dpc_jax.run.setup import make_network

pytestmark = pytest.mark.usefixtures("quickly")

COUNT, SIDE = 6, 8
KINDS = ("sigma", "covariance")
CAMERA = Camera()


def draw_shape(kind, *, objects=2):
    """What a head predicts for some objects, by name."""
    rng = np.random.default_rng(0)
    columns = 3 if kind == "covariance" else 1
    shape = {
        "points": rng.uniform(-0.3, 0.3, (objects, COUNT, 3)),
        "scale": rng.uniform(0.5, 0.9, objects),
        "sizes": rng.uniform(0.08, 0.25, (objects, COUNT, columns)),
    }
    if kind == "covariance":
        shape["turns"] = 2 * random_quaternions(4, objects, COUNT)
    return {name: jnp.array(a, jnp.float32) for name, a in shape.items()}


def make_shapes(kind):
    shape = draw_shape(kind)
    size, mass = point_sizes.measure_points(shape, grid=SIDE)
    return Points(shape["points"], shape["points"], None, shape["scale"], mass, size)


@pytest.mark.parametrize("kind", KINDS)
def test_sizes_and_masses_are_those_of_the_paper(kind):
    shape = draw_shape(kind)
    size, mass = point_sizes.measure_points(shape, grid=SIDE)
    for place in np.ndindex(2, COUNT):
        widths = SIDE * np.broadcast_to(np.asarray(shape["sizes"][place], float), 3)
        covariance = np.diag(widths**2)
        if kind == "covariance":
            turn = rotation_matrix(shape["turns"][place])
            covariance = turn @ covariance @ turn.T
            found = np.asarray(size[place])
        else:
            found = float(size[place]) ** 2 * np.eye(3)
        # Rounding of float32 in some ten operations.
        np.testing.assert_allclose(found, covariance, atol=1e-5)
        root = np.sqrt(np.linalg.det(covariance))
        peak = float(mass[place]) / ((2 * np.pi) ** 1.5 * root)
        assert peak == pytest.approx(float(shape["scale"][place[0]]), rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_grid_has_the_same_gaussians_in_smaller_voxels(kind):
    shape = draw_shape(kind)
    coarse = point_sizes.measure_points(shape, grid=SIDE)
    fine = point_sizes.measure_points(shape, grid=2 * SIDE)
    for ours, theirs in zip(
        point_sizes.scale_point_sizes(*coarse, 2.0), fine, strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5)


def sum_plainly(kind, points, mass, size, rotations, targets):
    """The views of two objects rendered side by side, and compared."""

    def render(points, mass, size, rotation):
        named: dict[str, Any] = {kind: size}
        image = project(points, rotation, scale=mass, grid=VoxelGrid(SIDE), **named)
        return image.silhouette

    views = jax.vmap(render, (None, None, None, 0))
    silhouettes = jax.vmap(views)(points, mass, size, rotations)
    return jnp.sum((silhouettes - targets) ** 2) / 4


@pytest.mark.parametrize("kind", KINDS)
def test_winners_have_the_loss_and_the_gradient_of_plain_renders(kind):
    config, batch = tiny_config(renders_at_once=1), make_batch()
    shapes = make_shapes(kind)
    rotations = jnp.array(random_quaternions(3, 2, 2), jnp.float32)
    targets = losses.downsample_images(batch["masks"], SIDE)

    def compare(points, mass, size):
        seen = dataclasses.replace(shapes, kept=points, mass=mass, sigma=size)
        total, *_ = compare_winners(
            seen,
            rotations,
            batch,
            recipe=make_recipe(config),
            stage=Stage(COUNT, SIDE),
        )
        return total

    learned = shapes.kept, shapes.mass, shapes.sigma
    places = tuple(range(3))
    total, found = jax.jit(jax.value_and_grad(compare, places))(*learned)
    plain = functools.partial(sum_plainly, kind, rotations=rotations, targets=targets)
    expected_total, expected = jax.jit(jax.value_and_grad(plain, places))(*learned)
    assert float(total) == pytest.approx(float(expected_total), rel=1e-5)
    for ours, theirs in zip(found, expected, strict=True):
        # The same float32 sums in another order, against the largest entry.
        limit = 2e-5 * float(jnp.max(jnp.abs(theirs)))
        assert limit > 0
        np.testing.assert_allclose(ours, theirs, atol=limit)


def sum_depths(points, masses, covariances, quaternion):
    """Optical depth of each pixel in float64, from covariances in the image."""
    turn = rotation_matrix(np.asarray(quaternion))
    cells, total = np.arange(-40, 41 + SIDE), 0
    for point, mass, covariance in zip(points, masses, covariances, strict=True):
        x, y, z = turn @ point
        zoom = CAMERA.focal_length / (z + CAMERA.distance)
        axes = []
        for place, axis in ((y, turn[1]), (x, turn[0])):
            center = (zoom * place + 0.5) * SIDE - 0.5
            variance = covariance if np.ndim(covariance) == 0 else 0
            if np.ndim(covariance):
                variance = zoom**2 * axis @ covariance @ axis
            weights = np.exp(-0.5 * (cells - center) ** 2 / variance)
            axes.append((weights / weights.sum())[40 : 40 + SIDE])
        total = total + mass * np.outer(*axes)
    return total


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_ranks_by_the_widths_of_gaussians_along_rows_and_columns(kind):
    shapes = make_shapes(kind)
    points, mass, size = (a[0] for a in (shapes.kept, shapes.mass, shapes.sigma))
    candidates = jnp.array(random_quaternions(5, 3), jnp.float32)
    target = jnp.array(np.random.default_rng(1).uniform(size=(SIDE, SIDE)), jnp.float32)
    places = place_candidates(
        points, candidates, side=SIDE, camera=CAMERA, choice_points=0, size=size
    )
    found = compute_image_losses(places, mass, target, sigma=size)
    squares = np.asarray(size, float)
    squares = squares**2 if kind == "sigma" else squares
    for candidate, loss in zip(candidates, found, strict=True):
        depth = sum_depths(np.asarray(points), np.asarray(mass), squares, candidate)
        expected = np.sum((1 - np.exp(-depth) - np.asarray(target, float)) ** 2)
        # Rounding of float32 in a few points' places and weights.
        assert float(loss) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_exact_choice_is_that_of_plain_renders(kind):
    shapes = make_shapes(kind)
    points, mass, size = (a[1] for a in (shapes.kept, shapes.mass, shapes.sigma))
    candidates = jnp.array(random_quaternions(6, 5), jnp.float32)
    grid = VoxelGrid(SIDE)

    def render(rotation):
        named: dict[str, Any] = {kind: size}
        return project(points, rotation, scale=mass, grid=grid, **named).silhouette

    images = jax.jit(functools.partial(jax.lax.map, render))(candidates)
    for settings in ({}, {"choice_points": 250}):
        choose = functools.partial(
            hindsight.choose_candidate, camera=CAMERA, choice_top=4, **settings
        )
        chosen = jax.jit(choose)(points, mass, candidates, images[3], sigma=size)
        assert int(chosen) == 3


@pytest.mark.parametrize("kind", KINDS)
def test_dropout_keeps_each_point_with_its_own_size_and_mass(kind):
    config = tiny_config(source="given", num_points=COUNT, point_size=kind)
    network = make_network(config)
    features = jnp.array(np.random.default_rng(0).normal(size=(2, 12)), jnp.float32)
    params = network.init(jax.random.key(0), jnp.zeros((1, 16, 16, 3)))
    predict = functools.partial(
        predict_shapes,
        params,
        features,
        jax.random.split(jax.random.key(1), 2),
        jnp.array(0.4),
        network=network,
        render=config.render,
    )
    whole, half = predict(kept_points=COUNT), predict(kept_points=COUNT // 2)
    for found in (whole, half):
        assert found.mass.shape == found.kept.shape[:2] == found.sigma.shape[:2]
    # The first half of one random order of the points.
    for name in ("kept", "mass", "sigma"):
        first = getattr(whole, name)[:, : COUNT // 2]
        np.testing.assert_array_equal(getattr(half, name), first)
    shape = network.apply(params, features, method="predict_shape")
    assert isinstance(shape, dict)
    sizes, masses = point_sizes.measure_points(shape, grid=SIDE)
    for i, j in np.ndindex(2, COUNT):
        same = np.all(
            np.asarray(shape["points"][i]) == np.asarray(whole.kept[i, j]), axis=1
        )
        [k] = np.flatnonzero(same)
        np.testing.assert_array_equal(whole.sigma[i, j], sizes[i, k])
        np.testing.assert_array_equal(whole.mass[i, j], masses[i, k])
