"""The shape head of voxel models, against XLA's own transposed convolution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax.networks.voxels import DoublingConv, VoxelHead


def test_a_doubling_is_a_transposed_convolution_of_kernel_4_and_stride_2():
    x = jax.random.normal(jax.random.key(0), (2, 4, 4, 4, 3))
    found, params = DoublingConv(5).init_with_output(jax.random.key(1), x)
    # Tap i of place a is cell 2i + a of the kernel.
    taps = params["params"]["kernel"].reshape(2, 2, 2, 3, 2, 2, 2, 5)
    kernel = taps.transpose(0, 4, 1, 5, 2, 6, 3, 7).reshape(4, 4, 4, 3, 5)
    expected = jax.lax.conv_general_dilated(
        x,
        kernel,
        window_strides=(1, 1, 1),
        padding=[(2, 2)] * 3,
        lhs_dilation=(2, 2, 2),
        dimension_numbers=("NDHWC", "DHWIO", "NDHWC"),
    )
    np.testing.assert_allclose(found, expected, atol=1e-5)  # sums of 24 products


@pytest.mark.parametrize("side", [8, 16])
def test_the_first_volume_is_thin_and_contained_where_that_is_asked_for(side):
    features = jax.random.normal(jax.random.key(0), (2, 16))
    free = VoxelHead(side, channels=4)
    shape, params = free.init_with_output(jax.random.key(1), features)
    assert set(shape) == {"cells"} and "colors" not in params["params"]
    cells = shape["cells"]
    np.testing.assert_allclose(cells, 0.05, atol=0.03)
    assert np.all(np.asarray(jnp.abs(cells[0] - cells[1])) > 0)  # of each its own
    held = VoxelHead(side, channels=4, is_contained=True, has_color=True)
    shape, _ = held.init_with_output(jax.random.key(1), features)
    assert shape["colors"].shape == (2, side, side, side, 3)
    axis = (np.arange(side) + 0.5) / side - 0.5
    radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis)), axis=0)
    expected = np.where(radius <= 0.5, cells, 0)
    np.testing.assert_array_equal(shape["cells"], expected)
    assert 0 < np.mean(expected == 0) < 0.5  # the corners: 1 - pi/6
