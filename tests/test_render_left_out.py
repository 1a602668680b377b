"""What a scene does not need is not in its compiled program."""

import functools
import re

import jax
import jax.numpy as jnp
import pytest
from tiny_runs import make_batch, make_network, make_recipe, make_state, tiny_config

import dpc_jax
from dpc_jax.learning.objective import compute_loss
from dpc_jax.learning.schedules import Stage

D, N = 20, 40
GRID = dpc_jax.VoxelGrid(D)
VOLUME = 4 * D**3  # bytes
POINTS, POSE = jax.ShapeDtypeStruct((N, 3), "float32"), jnp.array([1.0, 0, 0, 0])
SIGMA = jax.ShapeDtypeStruct((), "float32")
COLORS = jax.ShapeDtypeStruct((N, 3), "float32")


@functools.cache
def compile_sum(*arrays, gradient_of=(), **options):
    """The program of a sum over all images, or of its gradients."""

    def total(points, *others):
        names = ("sigma", "colors")[: len(others)]
        inputs = dict(zip(names, others, strict=True))
        images = dpc_jax.project(points, POSE, grid=GRID, **inputs, **options)
        return sum(jnp.sum(image) for image in jax.tree.leaves(images))

    function = jax.grad(total, argnums=gradient_of) if gradient_of else total
    return jax.jit(function).lower(*arrays).compile()


def count_flops(program):
    return program.cost_analysis()["flops"]


def test_colours_that_are_given_but_not_asked_for_cost_nothing():
    without, given = (
        compile_sum(POINTS, SIGMA, *colors, signals=("depth",))
        for colors in ((), (COLORS,))
    )
    assert count_flops(given) == count_flops(without)


def test_a_silhouette_has_no_product_along_the_ray_per_cell():
    # A cumulative product becomes windows that are reduced.
    depth, silhouette = (
        compile_sum(POINTS, SIGMA, signals=(name,)) for name in ("depth", "silhouette")
    )
    assert "reduce-window(" in depth.as_text()
    assert "reduce-window(" not in silhouette.as_text()
    assert count_flops(silhouette) < count_flops(depth)


def test_every_channel_of_colour_is_one_splat_and_none_is_kept():
    program = compile_sum(POINTS, SIGMA, COLORS, signals=("color",))
    many = jax.ShapeDtypeStruct((N, 30), "float32")
    wide = compile_sum(POINTS, SIGMA, many, signals=("color",))
    extra = (
        wide.memory_analysis().temp_size_in_bytes
        - program.memory_analysis().temp_size_in_bytes
    )
    assert extra < 2 * VOLUME  # of 27 more channels: images, not volumes


def test_a_known_sigma_is_smoothed_by_the_same_ways_as_a_traced_one():
    """With one way left XLA would compute sums of shifts again for each shift."""
    text = compile_sum(POINTS, sigma=0.5).as_text()
    assert re.search(r"branch_computations=\{(\S+, ){2}", text)  # three or more


def test_a_known_sigma_below_rounding_leaves_no_smoothing_in_the_program():
    program, smoothed = (compile_sum(POINTS, sigma=s) for s in (0.1, 0.5))
    assert "conditional(" not in program.as_text()
    # Three matrix products.
    assert count_flops(smoothed) > count_flops(program) + 3 * 2 * D**4


def test_a_sigma_without_gradient_keeps_no_volume_and_costs_no_smoothing():
    fixed = compile_sum(POINTS, SIGMA, gradient_of=(0,))
    moving = compile_sum(POINTS, SIGMA, gradient_of=(0, 1))
    assert count_flops(moving) > count_flops(fixed) + 3 * 2 * D**4
    extra = (
        moving.memory_analysis().temp_size_in_bytes
        - fixed.memory_analysis().temp_size_in_bytes
    )
    assert extra >= VOLUME


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
def test_backward_keeps_no_stack_of_volumes(method):
    side, count = 32, 40
    grid = dpc_jax.VoxelGrid(side)

    def total(points):
        def render(one):
            return dpc_jax.project(
                one, POSE, sigma=1.5, grid=grid, method=method
            ).silhouette

        return jnp.sum(jax.lax.map(render, points))

    clouds = jax.ShapeDtypeStruct((count, N, 3), "float32")
    found = jax.jit(jax.grad(total)).lower(clouds).compile().memory_analysis()
    # A sample keeps the occupancies that its rays end in (four bytes a cell), and where
    # they were clipped (one); with the basic method also the weights of its points.
    volume = 4 * side**3
    weights = 4 * 3 * N * side if method == "gaussian" else 0
    most = count * (1.3 * volume + 2 * weights)
    assert found.temp_size_in_bytes <= most + 12 * volume  # of the sample at work


@functools.cache
def lower_step(kept=24, **changes):
    """The text of a training step's gradient, of three heads."""
    config = tiny_config(**changes)
    network = make_network(config)
    state = jax.eval_shape(lambda: make_state(network, config))
    function = functools.partial(
        compute_loss,
        recipe=make_recipe(config, network),
        stage=Stage(kept_points=kept, grid=config.render.grid),
    )
    return (
        jax.jit(jax.grad(function, has_aux=True))
        .lower(
            state.params,
            make_batch(),
            jax.random.split(jax.random.key(0), 2),
            0,
            state.averages,
        )
        .as_text()
    )


def count_splats(text):
    """How many clouds a step splats: the batch dimension of its scatters."""
    updates = re.findall(
        r'"stablehlo.scatter"\(.*?\) -> tensor<(\S+?)x8x8x8xf32>',
        text,
        re.S,
    )
    return sum(
        functools.reduce(lambda a, b: a * int(b), found.split("x"), 1)
        for found in updates
    )


def test_candidates_of_a_known_pose_are_not_rendered():
    views = 4
    assert count_splats(lower_step(source="given")) == views
    assert count_splats(lower_step()) == (3 + 1) * views


def test_points_that_dropout_left_out_are_in_no_render():
    few, all_of_them = lower_step(kept=6), lower_step()
    windows = r"tensor<(?:\d+x)*{}x2x2x2xf32>"
    assert re.search(windows.format(6), few)
    assert not re.search(windows.format(24), few)
    assert re.search(windows.format(24), all_of_them)
