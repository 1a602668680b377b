"""Points to cells: trilinear splatting and B-splines, at the border and on ties."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from dpc_jax.render.fast import splatting

RNG = np.random.default_rng(0)


def draw_inside(shape, count=20):
    """Everywhere in the volume, on its faces, on centres of cells and between them."""
    places = RNG.uniform(-0.5, np.array(shape) - 0.5, (count, 3))
    places[:3] = [[-0.5] * 3, np.array(shape) - 0.5, np.array(shape) // 2]
    places[3:6] = np.round(places[3:6] * 2) / 2
    return places


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("shape", [(9, 7, 11), (1, 2, 9), (3, 7, 1)])
def test_a_point_gives_each_cell_the_spline_at_its_distance(order, shape):
    places, values = draw_inside(shape), RNG.uniform(size=20)
    spline = BSpline.basis_element(
        np.arange(order + 2) - (order + 1) / 2, extrapolate=False
    )
    right = np.zeros(shape)
    for place, value in zip(places, values, strict=True):
        axes = (np.arange(n) - x for n, x in zip(shape, place, strict=True))
        row, col, depth = (np.nan_to_num(spline(axis)) for axis in axes)
        right += value * row[:, None, None] * col[:, None] * depth
    with jax.enable_x64(True):
        inputs = jnp.asarray(places), jnp.asarray(values), shape
        found = splatting.splat_inside(*inputs, order)
    # float64, sums of some 60 products.
    np.testing.assert_allclose(found, right, atol=1e-14)
