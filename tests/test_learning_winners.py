"""The winners of the choice: Eq. 1 against plain renders, and the dropout's order."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_batch, make_recipe, random_quaternions, tiny_config

from dpc_jax.learning import losses
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes.points import Points, draw_order
from dpc_jax.render import VoxelGrid, project

pytestmark = pytest.mark.usefixtures("quickly")

SIGMA = 0.6  # voxels of the base grid, of side 8
FINE = Stage(kept_points=20, grid=16)


def make_shapes(*, has_colors):
    rng = np.random.default_rng(0)
    points = jnp.array(rng.uniform(-0.4, 0.4, (2, 20, 3)), jnp.float32)
    colors = jnp.array(rng.uniform(size=(2, 20, 3)), jnp.float32)
    mass = jnp.array([0.6, 0.9])
    return Points(
        points, points, colors if has_colors else None, mass, mass, jnp.array(SIGMA)
    )


def sum_plainly(learned, rotations, batch, *, color_weight):
    """All views rendered side by side, at twice the base grid, and compared."""

    def render(points, mass, colors, rotation):
        return project(
            points,
            rotation,
            sigma=2 * SIGMA,
            scale=8 * mass,
            colors=colors,
            grid=VoxelGrid(16),
            signals=("silhouette", "color"),
        )

    points, mass, colors = learned
    views = jax.vmap(render, (None, None, None, 0))
    image = jax.vmap(views)(points, mass, colors, rotations)
    silhouettes = losses.downsample_images(batch["masks"], 16)
    pictures = jnp.asarray(batch["images"], jnp.float32) / 255
    # 4 views; 4 fine pixels in a pixel of the base grid
    assert image.silhouette is not None and image.color is not None
    shape = jnp.sum((image.silhouette - silhouettes) ** 2) / 16
    return shape + color_weight * jnp.sum((image.color - pictures) ** 2) / 16


@pytest.mark.parametrize("renders_at_once", [0, 1])
@pytest.mark.parametrize("color_weight", [0.0, 0.3])
def test_winners_have_the_loss_and_gradient_of_plain_renders(
    color_weight, renders_at_once
):
    config = tiny_config(color_weight=color_weight, renders_at_once=renders_at_once)
    shapes, batch = make_shapes(has_colors=color_weight > 0), make_batch()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)

    def compare(learned, rotations):
        kept, mass, colors = learned
        seen = dataclasses.replace(shapes, kept=kept, mass=mass)
        if color_weight:
            seen = dataclasses.replace(seen, colors=colors)
        total, terms, _ = compare_winners(
            seen,
            rotations,
            batch,
            recipe=make_recipe(config),
            stage=FINE,
        )
        return 3 * total, terms  # so that the cotangent is not one

    learned = shapes.kept, shapes.mass, make_shapes(has_colors=True).colors
    call = jax.value_and_grad(compare, (0, 1), has_aux=True)
    (total, terms), found = jax.jit(call)(learned, rotations)
    plain = jax.value_and_grad(
        lambda a, b: 3 * sum_plainly(a, b, batch, color_weight=color_weight), (0, 1)
    )
    expected_total, expected = jax.jit(plain)(learned, rotations)
    assert float(total) == pytest.approx(float(expected_total), rel=1e-5)
    weighted = terms["reprojection"] + color_weight * terms.get("color", 0.0)
    assert 3 * float(weighted) == pytest.approx(float(total), rel=1e-6)
    assert set(terms) == {"reprojection"} | ({"color"} if color_weight else set())
    for ours, theirs in zip(
        jax.tree.leaves(found), jax.tree.leaves(expected), strict=True
    ):
        # The same float32 sums in another order, against the largest entry.
        limit = 2e-5 * float(jnp.max(jnp.abs(theirs))) + 1e-7
        np.testing.assert_allclose(ours, theirs, atol=limit)


def test_colors_that_move_no_points_leave_the_shape_the_gradient_of_silhouettes():
    shapes, batch = make_shapes(has_colors=True), make_batch()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)

    def compare(learned, config):
        kept, mass, colors, rotations = learned
        return compare_winners(
            dataclasses.replace(shapes, kept=kept, mass=mass, colors=colors),
            rotations,
            batch,
            recipe=make_recipe(config),
            stage=FINE,
        )[:2]

    learned = shapes.kept, shapes.mass, shapes.colors, rotations
    found = {}
    for name, changes in (
        ("beside", {"color_weight": 0.3, "colors_move_points": False}),
        ("joint", {"color_weight": 0.3}),
        ("silhouettes", {}),
    ):
        config = tiny_config(renders_at_once=1, **changes)
        call = jax.value_and_grad(lambda x, c=config: compare(x, c), has_aux=True)
        found[name] = jax.jit(call)(learned)
    (beside, terms), gradient = found["beside"]
    (joint, others), of_joint = found["joint"]
    _, of_silhouettes = found["silhouettes"]
    # The same float32 sums, compiled apart.
    assert float(beside) == pytest.approx(float(joint), rel=1e-6)
    assert float(terms["color"]) == pytest.approx(float(others["color"]), rel=1e-6)
    for index, name in enumerate(("points", "mass", "colors", "poses")):
        wanted = of_joint if name == "colors" else of_silhouettes
        limit = 1e-5 * float(jnp.max(jnp.abs(wanted[index])))
        np.testing.assert_allclose(gradient[index], wanted[index], atol=limit)
    assert float(jnp.max(jnp.abs(of_joint[0] - of_silhouettes[0]))) > 1e-3


@pytest.mark.parametrize("count", [1, 2, 3, 64, 1000])
def test_an_order_has_every_index_once_and_depends_on_the_key(count):
    orders = [
        np.asarray(draw_order(jax.random.key(seed), count=count)) for seed in (0, 0, 1)
    ]
    for order in orders:
        np.testing.assert_array_equal(np.sort(order), np.arange(count))
    np.testing.assert_array_equal(orders[0], orders[1])
    assert count < 64 or (orders[0] != orders[2]).any()


def test_every_index_comes_first_equally_often():
    keys = jax.random.split(jax.random.key(0), 20_000)
    orders = jax.jit(jax.vmap(lambda key: draw_order(key, count=10)))(keys)
    for place in (0, 4, 9):
        counts = np.bincount(np.asarray(orders[:, place]), minlength=10)
        # A binomial count of mean 2000 has a standard deviation of 42.
        np.testing.assert_allclose(counts, 2000, atol=5 * 42)
