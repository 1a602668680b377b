"""Denser clouds: midpoints of neighbours. Stray points: those that hang alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from dpc_jax.evaluation.density import (
    count_stray_points,
    densify,
    find_pairs,
    mix_pairs,
)


def make_sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return 0.4 * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_every_new_point_is_halfway_between_a_point_and_one_of_its_nearest():
    points = make_sphere(100)
    dense = densify(points, 300)
    assert dense.shape == (300, 3)
    np.testing.assert_array_equal(dense[:100], points)
    ranks = np.argsort(np.argsort(cdist(points, points), axis=1), axis=1)
    first, second = np.triu_indices(100, 1)
    near = np.minimum(ranks[first, second], ranks[second, first]) <= 16
    allowed = (points[first[near]] + points[second[near]]) / 2
    gaps = cdist(dense[100:], allowed)
    assert gaps.min(axis=1).max() < 1e-15  # sums of two numbers below 1, halved
    assert len(set(gaps.argmin(axis=1))) == 200  # no pair twice


@given(
    count=st.integers(1, 40), wanted=st.integers(-5, 400), seed=st.integers(0, 2**16)
)
def test_a_dense_cloud_keeps_its_points_and_has_no_more_than_asked_for(
    count, wanted, seed
):
    rng = np.random.default_rng(seed)
    # Some of them in one place.
    points = rng.integers(0, 4, size=(count, 3)) / 4.0
    dense = densify(points, wanted)
    np.testing.assert_array_equal(dense[:count], points)
    assert len(dense) <= max(count, wanted)
    assert (dense.min(axis=0) >= points.min(axis=0)).all()
    assert (dense.max(axis=0) <= points.max(axis=0)).all()
    np.testing.assert_array_equal(dense, densify(points, wanted))


def test_colours_are_mixed_by_the_same_pairs_as_places():
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.0, 3, 0]])
    colors = np.eye(3)
    pairs = find_pairs(points, 3)
    assert {tuple(pair) for pair in pairs.tolist()} == {(0, 1), (0, 2), (1, 2)}
    middles, mixed = mix_pairs(points, pairs), mix_pairs(colors, pairs)
    for middle, mix in zip(middles, mixed, strict=True):
        np.testing.assert_allclose(mix @ points, middle, atol=1e-15)


@pytest.mark.parametrize("bad", [np.empty((0, 3)), [[0.0, np.nan, 0.0]], [1.0, 2.0]])
def test_what_is_no_cloud_is_refused(bad):
    with pytest.raises(ValueError, match="points"):
        densify(bad)


def make_dense_sphere(count=500, seed=0):
    return 0.75 * make_sphere(count, seed)


def test_a_surface_has_none_and_points_away_from_it_are_counted():
    surface = make_dense_sphere()
    assert count_stray_points(surface) == 0
    away = np.array([[0, 0, 0.61], [0.02, 0, 0.61], [0.5, 0, 0]])  # two side by side
    assert count_stray_points(np.concatenate([surface, away])) == 3


def test_a_group_of_five_is_a_part_of_the_shape():
    group = np.array([0, 0, 0.6]) + 0.01 * make_dense_sphere(5, seed=1)
    assert count_stray_points(np.concatenate([make_dense_sphere(), group])) == 0
    assert count_stray_points(np.concatenate([make_dense_sphere(), group[:4]])) == 4


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_cloud_of_few_points_can_have_none_or_all(count):
    near = 0.01 * make_dense_sphere(count)
    assert count_stray_points(near) == 0
    if count > 1:
        assert count_stray_points(100 * near) == count
