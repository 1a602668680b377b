"""The shape head of voxel models, against XLA's own transposed convolution."""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax.networks.voxels import DoublingConv, VoxelHead

pytestmark = pytest.mark.usefixtures("quickly")


def test_a_doubling_is_a_transposed_convolution_of_kernel_4_and_stride_2():
    layer = DoublingConv(5)
    x = jax.random.normal(jax.random.key(0), (2, 4, 4, 4, 3))
    params = layer.init(jax.random.key(1), x)
    found = layer.apply(params, x)
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
    assert found.shape == (2, 8, 8, 8, 5)
    np.testing.assert_allclose(found, expected, atol=1e-5)  # sums of 24 products


@pytest.mark.parametrize("side", [8, 16])
def test_the_first_volume_is_thin_everywhere_and_colours_come_if_asked_for(side):
    head = VoxelHead(side, channels=4, has_color=side == 16)
    features = jax.random.normal(jax.random.key(0), (3, 16))
    shape, params = head.init_with_output(jax.random.key(1), features)
    assert shape["cells"].shape == (3, side, side, side)
    np.testing.assert_allclose(shape["cells"], 0.05, atol=0.03)
    assert ("colors" in shape) == ("colors" in params["params"]) == (side == 16)
    if side == 16:
        assert shape["colors"].shape == (3, 16, 16, 16, 3)


@pytest.mark.parametrize("side", [8, 16])
def test_contained_cells_are_empty_where_no_object_reaches_and_others_stay(side):
    features = jax.random.normal(jax.random.key(0), (2, 16))
    free = VoxelHead(side, channels=4)
    params = free.init(jax.random.key(1), features)
    whole = free.apply(params, features)["cells"]
    held = VoxelHead(side, channels=4, is_contained=True).apply(params, features)
    axis = (np.arange(side) + 0.5) / side - 0.5
    radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis)), axis=0)
    expected = np.where(radius <= 0.5, whole, 0)
    np.testing.assert_array_equal(held["cells"], expected)
    assert 0 < np.mean(expected == 0) < 0.5  # the corners: 1 - pi/6


def test_every_cell_depends_on_the_features():
    head = VoxelHead(8, channels=4)
    features = jax.random.normal(jax.random.key(0), (2, 16))
    params = head.init(jax.random.key(1), features)
    cells = head.apply(params, features)["cells"]
    assert isinstance(cells, jax.Array)
    assert np.all(np.asarray(jnp.abs(cells[0] - cells[1])) > 0)
    assert isinstance(head, nn.Module)
