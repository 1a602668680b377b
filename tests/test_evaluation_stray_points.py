"""Stray points of a cloud: those that hang alone."""

import numpy as np
import pytest

from dpc_jax.evaluation.stray_points import count_stray_points


def make_sphere(count=500, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize("bad", [np.empty((0, 3)), [[0.0, np.nan, 0.0]]])
def test_what_is_no_cloud_is_refused(bad):
    with pytest.raises(ValueError, match="points"):
        count_stray_points(bad)


def test_a_surface_has_none_and_points_away_from_it_are_counted():
    surface = make_sphere()
    assert count_stray_points(surface) == 0
    away = np.array([[0, 0, 0.61], [0.02, 0, 0.61], [0.5, 0, 0]])  # two side by side
    assert count_stray_points(np.concatenate([surface, away])) == 3


def test_a_group_of_five_is_a_part_of_the_shape():
    group = np.array([0, 0, 0.6]) + 0.01 * make_sphere(5, seed=1)
    assert count_stray_points(np.concatenate([make_sphere(), group])) == 0
    assert count_stray_points(np.concatenate([make_sphere(), group[:4]])) == 4


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_cloud_of_few_points_can_have_none_or_all(count):
    near = 0.01 * make_sphere(count)
    assert count_stray_points(near) == 0
    if count > 1:
        assert count_stray_points(100 * near) == count
