"""Points to cells: trilinear splatting and B-splines, at the border and on ties."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

import dpc_jax
from dpc_jax.render.fast import splines

RNG = np.random.default_rng(0)


def draw_inside(shape, count=20):
    """Everywhere in the volume, on its faces, on centres of cells and between them."""
    places = RNG.uniform(-0.5, np.array(shape) - 0.5, (count, 3))
    places[:3] = [[-0.5] * 3, np.array(shape) - 0.5, np.array(shape) // 2]
    places[3:6] = np.round(places[3:6] * 2) / 2
    return places


@pytest.mark.parametrize(
    "order, shape",
    [(order, (9, 7, 11)) for order in (0, 1, 2, 3)]
    + [(0, shape) for shape in ((1, 1, 9), (1, 7, 1), (1, 1, 1))],
)
def test_a_point_gives_each_cell_the_spline_at_its_distance(order, shape):
    """Order 0 stands for `splat`, whose weights are those of order 1."""
    places, values = draw_inside(shape), RNG.uniform(size=20)
    degree = order or 1
    spline = BSpline.basis_element(
        np.arange(degree + 2) - (degree + 1) / 2, extrapolate=False
    )
    right = np.zeros(shape)
    for place, value in zip(places, values, strict=True):
        axes = (np.arange(n) - x for n, x in zip(shape, place, strict=True))
        row, col, depth = (np.nan_to_num(spline(axis)) for axis in axes)
        right += value * row[:, None, None] * col[:, None] * depth
    with jax.enable_x64(True):
        inputs = jnp.asarray(places), jnp.asarray(values), shape
        found = splines.splat(*inputs, order) if order else dpc_jax.splat(*inputs)
    # float64, sums of some 60 products.
    np.testing.assert_allclose(found, right, atol=1e-14)
