"""Errors of rendered images against values by hand."""

import numpy as np
import pytest

from dpc_jax.evaluation import images

MASK = np.array([[1.0, 0.5], [0.4, 0.0]])


def test_the_depth_error_is_the_mean_over_covered_pixels():
    true = np.array([[1.8, 2.0], [2.2, 2.5]])
    away = np.array([[0.1, -0.3], [9.0, 9.0]])  # where little or nothing is covered
    assert images.depth_error(true + away, true, MASK) == pytest.approx(0.2)


def test_the_psnr_is_that_of_the_covered_pixels_and_finite_for_equal_colours():
    true, away = np.full((2, 2, 3), 0.5), np.full((2, 2, 3), 0.4)
    away[0] = 0.1
    assert images.color_psnr(true + away, true, MASK) == pytest.approx(20.0)
    assert images.color_psnr(true, true, MASK) == pytest.approx(100.0)


def test_without_a_covered_pixel_there_is_nothing_to_measure():
    nothing = np.zeros((2, 2))
    assert images.depth_error(nothing, nothing, nothing) is None
    assert images.color_psnr(np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), nothing) is None


def test_images_of_any_sizes_are_compared_at_one():
    rng = np.random.default_rng(0)
    small, target = rng.uniform(size=(2, 4, 4))
    expected = np.mean((small - target) ** 2)
    for size in (4, 8, 32, 64):
        scale = np.ones((size // 4, size // 4))
        found = images.mean_squared_difference(np.kron(small, scale), target)
        assert found == pytest.approx(expected, rel=1e-12)  # rounding of float64
    # Four pixels of a checkerboard average to grey.
    board = np.tile([[0.0, 1], [1, 0]], (2, 2))
    np.testing.assert_array_equal(images.resize(board, 2), np.full((2, 2), 0.5))
