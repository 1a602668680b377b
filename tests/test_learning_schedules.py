"""Schedules over a run, and the learned scale."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_network, tiny_config

from dpc_jax.learning.schedules import (
    FINE_FROM,
    compute_sigma,
    count_kept_points,
    find_stage,
    is_framing,
    list_spans,
)
from dpc_jax.learning.shapes.points import Points, compute_mass
from dpc_jax.render import Camera, VoxelGrid, voxelize

SIDE = 33  # odd: the origin is a cell's centre


def sigma_at(step, config):
    return compute_sigma(step, config.render, steps=config.train.steps)


def kept_at(step, config):
    return count_kept_points(step, config.render, steps=config.train.steps)


def test_the_number_of_kept_points_rises_in_stairs_to_its_end():
    config = tiny_config(steps=1000, num_points=2000, keep_start=0.07, keep_end=0.5)
    kept = np.array([kept_at(s, config) for s in range(1000)])
    assert np.all(np.diff(kept) >= 0)
    assert len(np.unique(kept)) == 8  # programs to compile
    assert kept[-1] == 1000
    # All stairs but the last lie around the line, by at most half a stair.
    line = 2000 * (0.07 + 0.43 * np.arange(1000) / 1000)
    assert np.all(np.abs(kept - line)[:875] <= 0.43 * 2000 / 8 / 2 + 1)
    # One point is left at least.
    few = dict(num_points=3, keep_start=1e-3, keep_end=1e-3)
    assert kept_at(0, tiny_config(**few)) == 1


@pytest.mark.parametrize("until", [0.5, 0.8])
def test_size_and_dropout_reach_their_ends_before_the_run_does(until):
    config = tiny_config(steps=100, num_points=1000, keep_end=1.0, anneal_until=until)
    last = int(until * 100)
    end = config.render.sigma_end * config.render.grid
    assert sigma_at(last, config) == pytest.approx(end, rel=1e-6)
    assert sigma_at(last // 2, config) > 1.2 * end
    assert kept_at(last, config) == 1000
    assert kept_at(last * 7 // 8 - 1, config) < 1000


@pytest.mark.parametrize(
    "fields",
    [
        dict(steps=10, grid=8, fine_grid=16),
        dict(steps=10, keep_end=1.0),
        dict(steps=100, keep_start=1.0, keep_end=1.0),
    ],
)
def test_spans_are_the_stages_of_the_steps_in_their_order(fields):
    config = tiny_config(**fields)
    render, steps = config.render, config.train.steps
    stages = [find_stage(step, render, steps=steps) for step in range(steps)]
    spans = list_spans(render, steps=steps)
    assert [s.stage for s in spans for _ in range(s.start, s.end)] == stages
    assert len(spans) == len(set(stages))
    fine = fields.get("fine_grid", 8)
    assert [s.grid for s in stages] == [
        fine if step >= 0.6 * steps else 8 for step in range(steps)
    ]


# The learned scale.


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


@pytest.mark.parametrize(("scale", "sigma"), [(0.3, 0.2), (0.9, 1.0), (0.9, 1.6)])
def test_a_point_fills_its_cell_by_the_coefficient_or_all_cells_in_unit_mass(
    scale, sigma
):
    volume = occupy(scale, sigma, "peak")
    middle = SIDE // 2
    assert float(volume[middle, middle, middle]) == pytest.approx(scale, rel=1e-4)
    # Its neighbour as Eq. 3 says: c·exp(-1 / 2σ²).
    beside = float(volume[middle, middle, middle + 1])
    assert beside == pytest.approx(scale * np.exp(-0.5 / sigma**2), rel=1e-3)
    volume = occupy(scale, sigma, "mass")
    assert float(jnp.sum(volume)) == pytest.approx(scale, rel=1e-4)


def test_a_fixed_scale_is_that_number_for_every_object():
    config = tiny_config(source="given", scale_fixed=0.7)
    network = make_network(config)
    params = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, 16, 16, 3)))
    features = jax.random.normal(jax.random.key(1), (2, 12))
    output = network.apply(params, features, method="predict_shape")
    shapes = Points.read(output, jnp.array(1.0), render=config.render)
    np.testing.assert_array_equal(shapes.scale, np.float32([0.7, 0.7]))
    np.testing.assert_array_equal(shapes.mass, np.float32([0.7, 0.7]))
    assert "scale" not in params["params"]["shape"]


def test_grids_beyond_128_begin_when_blocks_can_draw_their_points():
    fields = dict(steps=100, grid=16, anneal_until=0.8, sigma_start=0.05)
    render = tiny_config(fine_grid=32, sigma_end=0.003, **fields).render
    large = dataclasses.replace(render, grid=64, fine_grid=256)
    (start,) = {
        span.start for span in list_spans(large, steps=100) if span.stage.max_blocks
    }
    assert start > FINE_FROM * 100
    sizes = [
        4 * float(compute_sigma(step, large, steps=100)) for step in (start - 1, start)
    ]
    assert sizes[0] > 1.3 >= sizes[1]
    assert find_stage(99, large, steps=100).max_blocks == 32**3 // 8
    assert find_stage(99, render, steps=100).max_blocks is None
    # One that never becomes so small is rendered finely when it is smallest.
    wide = dataclasses.replace(large, sigma_end=0.04)
    assert find_stage(79, wide, steps=100).grid == 64
    assert find_stage(80, wide, steps=100).grid == 256


def test_objects_are_turned_while_shapes_form_and_by_colors_to_the_end():
    steps = np.arange(100)
    by_points, by_colors = (
        np.asarray(is_framing(steps, steps=100, by_colors=way)) for way in (False, True)
    )
    assert np.array_equal(by_points, (steps >= 20) & (steps < 50))
    assert np.array_equal(by_colors, steps >= 20)


def test_with_a_fine_grid_the_number_of_points_changes_once_where_it_begins():
    fields = dict(steps=100, num_points=1000, keep_start=0.25, keep_end=0.5)
    config = tiny_config(fine_grid=16, **fields)
    spans = list_spans(config.render, steps=100)
    kept = [(span.start, span.stage.kept_points) for span in spans]
    assert kept == [(0, 250), (FINE_FROM * 100, 500)]
