"""Stray points: those that hang alone."""

import numpy as np
import pytest

from dpc_jax.evaluation.density import count_stray_points


def draw_surface(count=500, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_a_surface_has_none_and_points_away_from_it_are_counted():
    surface = draw_surface()
    assert count_stray_points(surface) == 0
    away = np.array([[0, 0, 0.61], [0.02, 0, 0.61], [0.5, 0, 0]])  # two side by side
    assert count_stray_points(np.concatenate([surface, away])) == 3


def test_a_group_of_five_is_a_part_of_the_shape():
    group = np.array([0, 0, 0.6]) + 0.01 * draw_surface(5, seed=1)
    assert count_stray_points(np.concatenate([draw_surface(), group])) == 0
    assert count_stray_points(np.concatenate([draw_surface(), group[:4]])) == 4


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_cloud_of_few_points_can_have_none_or_all(count):
    near = 0.01 * draw_surface(count)
    assert count_stray_points(near) == 0
    if count > 1:
        assert count_stray_points(100 * near) == count


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite"):
        count_stray_points(np.full((3, 3), np.nan))
