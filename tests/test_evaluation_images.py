"""Errors of rendered images against values by hand."""

import numpy as np
import pytest

from dpc_jax.evaluation import images

MASK = np.array([[1.0, 0.5], [0.4, 0.0]])


def test_the_depth_error_is_the_mean_over_covered_pixels():
    true = np.array([[1.8, 2.0], [2.2, 2.5]])
    away = np.array([[0.1, -0.3], [9.0, 9.0]])  # where little or nothing is covered
    assert images.depth_error(true + away, true, MASK) == pytest.approx(0.2)


def test_the_psnr_is_that_of_the_covered_pixels():
    true = np.full((2, 2, 3), 0.5)
    away = np.zeros_like(true)
    away[0] = 0.1
    away[1] = 0.4
    assert images.color_psnr(true + away, true, MASK) == pytest.approx(20.0)


def test_equal_colors_have_a_finite_psnr():
    image = np.full((2, 2, 3), 0.5)
    assert images.color_psnr(image, image, MASK) == pytest.approx(100.0)


def test_without_a_covered_pixel_there_is_nothing_to_measure():
    nothing = np.zeros((2, 2))
    assert images.depth_error(nothing, nothing, nothing) is None
    assert images.color_psnr(np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), nothing) is None
    assert images.mean_of_known([None, 1.0, 3.0]) == 2.0
    assert images.mean_of_known([None]) is None
