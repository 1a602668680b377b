"""Chamfer distance against loops in float64, and what it refuses."""

import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from dpc_jax.evaluation import chamfer_distance
from dpc_jax.evaluation.chamfer import Surface, count_stray_points, spread_rows


def mean_gap_by_loops(a, b):
    total = 0.0
    for p in a.tolist():
        total += min(math.dist(p, q) for q in b.tolist())
    return total / len(a)


PREDICTED, TRUTH = np.split(np.random.default_rng(0).normal(size=(150, 3)), [60])


def test_chamfer_equals_the_loops_over_all_pairs():
    got = chamfer_distance(PREDICTED, TRUTH)
    # Both sum under 100 float64 distances of order 1: 1e-12 leaves room for the order.
    precision, coverage = (
        mean_gap_by_loops(*pair) for pair in ((PREDICTED, TRUTH), (TRUTH, PREDICTED))
    )
    assert tuple(got) == pytest.approx((precision, coverage), abs=1e-12)
    assert got.chamfer == got.precision + got.coverage


def test_a_surface_may_ask_few_of_its_points_and_is_as_near_with_all():
    few = Surface(TRUTH, asked=10).compare(PREDICTED)
    assert few.precision == chamfer_distance(PREDICTED, TRUTH).precision
    asked = spread_rows(TRUTH, 10)
    assert few.coverage == chamfer_distance(PREDICTED, asked).coverage


@pytest.mark.parametrize("count", [20, 80])
def test_the_floor_is_the_distance_of_some_points_from_the_others(count):
    rows = np.linspace(0, 89, min(count, 45)).round().astype(int)
    expected = chamfer_distance(TRUTH[rows], np.delete(TRUTH, rows, axis=0))
    floor = Surface(TRUTH).measure_floor(count)
    assert floor.coverage == pytest.approx(expected.coverage, abs=1e-12)
    # Its points are near to each other, too: to those that it has itself.
    away = cdist(TRUTH[rows], TRUTH)
    away[np.arange(len(rows)), rows] = np.inf
    assert floor.precision == pytest.approx(away.min(axis=1).mean(), abs=1e-12)


@pytest.mark.parametrize(
    ("predicted", "truth", "words"),
    [
        (np.zeros((1, 3)), np.zeros((0, 3)), "ground_truth.* at least one point"),
        (np.zeros((2, 4, 3)), np.zeros((1, 3)), "one cloud per call"),
        (np.array([[0, 0, np.nan]]), np.zeros((1, 3)), "1 of 1 points have NaN"),
    ],
)
def test_clouds_unfit_for_a_distance_are_refused_in_a_sentence(predicted, truth, words):
    with pytest.raises(ValueError, match=words):
        chamfer_distance(predicted, truth)


def make_sphere(count=500, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True)


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
