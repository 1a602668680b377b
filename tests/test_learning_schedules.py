"""Schedules over a run: the paper's ends, at every resolution and length."""

import numpy as np
import pytest
from tiny_runs import tiny_config

from dpc_jax.learning.schedules import (
    compute_sigma,
    count_kept_points,
    find_stage,
    list_spans,
    make_learning_rate,
)


def sigma_at(step, config):
    return compute_sigma(step, config.render, steps=config.train.steps)


def kept_at(step, config):
    return count_kept_points(step, config.render, steps=config.train.steps)


def stage_at(step, config):
    return find_stage(step, config.render, steps=config.train.steps)


@pytest.mark.parametrize("grid", [8, 32, 64, 128])
@pytest.mark.parametrize("steps", [1, 10, 600_000])
def test_sigma_goes_from_five_to_a_third_of_a_percent_of_the_volume(grid, steps):
    config = tiny_config(grid=grid, steps=steps, sigma_start=0.05, sigma_end=0.003)
    # float32, relative.
    assert sigma_at(0, config) == pytest.approx(0.05 * grid, rel=1e-5)
    assert sigma_at(steps, config) == pytest.approx(0.003 * grid, rel=1e-5)
    middle = sigma_at(steps / 2, config)
    assert middle == pytest.approx(0.0265 * grid, rel=1e-5)


def test_sigma_stays_at_its_end_beyond_the_last_step():
    config = tiny_config(steps=10)
    assert sigma_at(25, config) == sigma_at(10, config)


@pytest.mark.parametrize("levels", [1, 2, 5, 32])
def test_the_number_of_kept_points_rises_in_stairs_to_its_end(levels):
    config = tiny_config(
        steps=1000, num_points=2000, keep_start=0.07, keep_end=1.0, keep_levels=levels
    )
    kept = np.array([kept_at(s, config) for s in range(1000)])
    assert np.all(np.diff(kept) >= 0)
    assert len(np.unique(kept)) == levels
    assert kept[-1] == 2000
    # All stairs but the last lie around the line, by at most half a stair.
    line = 2000 * (0.07 + 0.93 * np.arange(1000) / 1000)
    inner = slice(0, 1000 * (levels - 1) // levels)
    assert np.all(np.abs(kept - line)[inner] <= 0.93 * 2000 / levels / 2 + 1)


def test_without_dropout_all_points_are_rendered_by_one_program_per_grid():
    config = tiny_config(steps=100, num_points=50, keep_start=1.0, keep_levels=32)
    assert {kept_at(step, config) for step in range(100)} == {50}
    assert len(list_spans(config.render, steps=100)) == 1


def test_the_last_stair_keeps_the_end_value_and_at_least_one_point_is_left():
    config = tiny_config(num_points=40, keep_start=0.1, keep_end=0.5, keep_levels=3)
    assert kept_at(config.train.steps - 1, config) == 20
    assert kept_at(config.train.steps + 5, config) == 20
    few = tiny_config(num_points=3, keep_start=1e-3, keep_end=1e-3, keep_levels=1)
    assert kept_at(0, few) == 1


def test_a_run_shorter_than_its_stairs_ends_with_all_points():
    config = tiny_config(steps=3, keep_levels=32)
    assert kept_at(2, config) <= config.render.num_points
    longer = tiny_config(steps=32, keep_levels=32)
    assert kept_at(31, longer) == longer.render.num_points


def rates(*steps, **changes):
    schedule = make_learning_rate(tiny_config(**changes).train)
    return [float(schedule(step)) for step in steps]


def test_the_learning_rate_of_the_paper_is_constant():
    found = rates(0, 1, 500, 999, steps=1000, learning_rate=1e-4, schedule="constant")
    assert found == pytest.approx(4 * [1e-4], rel=1e-6)  # float32


def test_the_learning_rate_warms_up_linearly_and_decays_as_a_cosine():
    first, second, peak, middle, last, after = rates(
        *(0, 1, 200, 700, 1200, 2000),
        **dict(steps=1200, learning_rate=1e-2, schedule="cosine"),
    )
    # float32; the first step already moves, by 1 / 200 of the peak. The line of the
    # warm-up reaches the peak at step 200.
    assert first == pytest.approx(5e-5, rel=1e-5)
    assert second == pytest.approx(5e-5 + 1e-2 * 0.995 / 200, rel=1e-5)
    assert peak == pytest.approx(1e-2, rel=1e-5)
    assert middle == pytest.approx(1e-2 * (1 + 0.02) / 2, rel=1e-4)
    assert last == after == pytest.approx(2e-4, rel=1e-4)


@pytest.mark.parametrize("steps", [1, 4, 20])
def test_the_warm_up_of_a_short_run_takes_a_fifth_of_it(steps):
    found = rates(*range(steps), steps=steps, schedule="cosine", learning_rate=1e-3)
    assert found[steps // 5] == max(found) == pytest.approx(1e-3, rel=1e-5)


def test_the_finer_grid_comes_in_from_its_share_of_the_run():
    config = tiny_config(steps=10, grid=8, fine_grid=16)
    stages = [stage_at(step, config) for step in range(10)]
    assert [s.grid for s in stages] == 6 * [8] + 4 * [16]
    assert [s.kept_points for s in stages] == [
        kept_at(step, config) for step in range(10)
    ]


def test_without_a_finer_grid_a_run_has_a_stage_for_each_stair_only():
    config = tiny_config(steps=10, keep_levels=3)
    stages = {stage_at(step, config) for step in range(10)}
    assert len(stages) == 3
    assert {s.grid for s in stages} == {8}


@pytest.mark.parametrize("until", [0.5, 0.8])
def test_size_and_dropout_reach_their_ends_before_the_run_does(until):
    config = tiny_config(
        steps=100, num_points=1000, keep_levels=4, keep_end=1.0, anneal_until=until
    )
    last = int(until * 100)
    end = config.render.sigma_end * config.render.grid
    assert sigma_at(last, config) == pytest.approx(end, rel=1e-6)
    assert sigma_at(99, config) == pytest.approx(end, rel=1e-6)
    assert sigma_at(last // 2, config) > 1.2 * end
    assert kept_at(last, config) == 1000
    assert kept_at(last * 3 // 4 - 1, config) < 1000
