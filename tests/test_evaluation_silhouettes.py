"""The difference of silhouettes: at one size, whatever the images' own."""

import numpy as np
import pytest

from dpc_jax.evaluation.images import mean_squared_difference


def test_images_of_any_sizes_are_compared_at_one():
    rng = np.random.default_rng(0)
    small, target = rng.uniform(size=(2, 4, 4))
    expected = np.mean((small - target) ** 2)
    for size in (4, 8, 32, 64):
        scale = np.ones((size // 4, size // 4))
        found = mean_squared_difference(np.kron(small, scale), target)
        assert found == pytest.approx(expected, rel=1e-12)  # rounding of float64
    # Four pixels of a checkerboard average to grey.
    board = np.tile([[0.0, 1], [1, 0]], (2, 2))
    assert mean_squared_difference(board, np.full((2, 2), 0.5), side=2) == 0
    assert mean_squared_difference(board, np.zeros((4, 4)), side=4) == 0.5


@pytest.mark.parametrize("shape", [(4, 6), (4,), (0, 0), (24, 24)])
def test_an_image_that_cannot_be_brought_to_that_size_is_refused(shape):
    with pytest.raises(ValueError, match="square image whose side divides 32"):
        mean_squared_difference(np.zeros(shape), np.zeros((32, 32)))
