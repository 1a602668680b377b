"""Splatting by B-splines, the first step of the fast method: points to cells near them.

Along each axis a point goes to `order` + 1 cells; order 1 is the paper's trilinear
method. The derivative of an image with respect to a point is as smooth as the spline:
constant inside of a cell for order 1, linear for 2, quadratic for 3.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from dpc_jax.render import checks

ORDERS = {"trilinear": 1, "quadratic": 2, "cubic": 3}
_IN_BOUNDS = "promise_in_bounds"


def splat(
    coordinates: jax.Array,
    values: jax.Array,
    shape: tuple[int, int, int],
) -> jax.Array:
    """Spread each point's value over its eight neighbouring cells.

    Part of Eq. 3 by the fast method (appendix "Differentiable point cloud projection").

    Args:
      coordinates: [N, 3] continuous (row, col, depth) index, cell centres at integers.
        A point outside the volume, beyond [-1/2, D - 1/2] along an axis, contributes
        nothing; a point inside loses the share that falls on cells outside.
      values: [N], what each point adds in total.
      shape: (rows, cols, depth), static.

    Returns:
      [rows, cols, depth]. The weights are linear between cell centres, so their
      derivative jumps there; on a cell centre it is that towards the higher index.

    Raises:
      ValueError: for another shape or dtype.

    Example:
      >>> volume = dpc_jax.splat(jnp.array([[1.5, 2, 2]]), jnp.ones(1), (4, 4, 4))
      >>> float(volume[1, 2, 2])
      0.5
    """
    shape = checks.check_sides("shape", shape)
    coordinates = checks.check_array("coordinates", coordinates, (None, 3))
    values = checks.check_array("values", values, coordinates.shape[:1])
    sizes = jnp.array(shape, coordinates.dtype)[None]
    is_inside = jnp.all((coordinates >= -0.5) & (coordinates <= sizes - 0.5), axis=-1)
    coordinates = jnp.where(is_inside[:, None], coordinates, 0)
    return splat_inside(coordinates, jnp.where(is_inside, values, 0), shape, 1)


def splat_inside(
    coordinates: jax.Array, values: ArrayLike, shape: tuple[int, int, int], order: int
) -> jax.Array:
    """Points [N, 3] inside of a volume to its cells, [rows, cols, depth]."""
    rows, cols, depth = shape
    first = find_first(jax.lax.stop_gradient(coordinates), shape, order)
    slot = jnp.zeros(first.shape[0], jnp.int32)
    values = jnp.asarray(values, coordinates.dtype)
    room = (1, *(max(side, order + 1) for side in shape))
    cells: Any = scatter(coordinates - first, values, slot, first, order, room)
    return cells[0, :rows, :cols, :depth]


def find_first(
    coordinates: jax.Array, shape: tuple[int, int, int], order: int
) -> jax.Array:
    """The first cell along each axis that a point goes to, [N, 3] int32.

    All `order` + 1 are inside of the volume. A point near to a side gives nothing to
    those that its spline does not reach, and what falls outside is lost.
    """
    first = jnp.floor(coordinates - (order - 1) / 2)
    most = jnp.array([max(side - order - 1, 0) for side in shape])[None]
    return jnp.clip(first, 0, most.astype(first.dtype)).astype(jnp.int32)


@functools.partial(jax.custom_vjp, nondiff_argnums=(4, 5))
def scatter(
    offset: jax.Array,
    values: jax.Array,
    slot: jax.Array,
    cell: jax.Array,
    order: int,
    shape: tuple[int, int, int, int],
) -> jax.Array:
    """Add up the points' splines in stores of cells, (M, rows, cols, depth) in shape.

    A point has the `offset` [N, 3] from its first `cell` [N, 3] in the store of the
    number `slot` [N]. On a kink of order 1 the derivative is that towards the higher
    index.
    """
    return _add(offset, values, slot, cell, order, shape)


def _scatter_forward(offset, values, slot, cell, order, shape):
    cells = scatter(offset, values, slot, cell, order, shape)
    return cells, (offset, values, slot, cell)


def _scatter_backward(order, _, residuals, cotangent):
    offset, values, slot, cell = residuals
    value, slopes = _read(cotangent, offset, slot, cell, order)
    return values[:, None] * slopes, value, None, None


scatter.defvjp(_scatter_forward, _scatter_backward)


def _add(offset, values, slot, cell, order, shape):
    row, col, depth = (_weigh(t, order)[0] for t in offset.T)
    windows = row[:, :, None, None] * col[:, None, :, None] * depth[:, None, None, :]
    return jax.lax.scatter_add(
        jnp.zeros(shape, values.dtype),
        jnp.concatenate([slot[:, None], cell], axis=1),
        values[:, None, None, None] * windows,
        jax.lax.ScatterDimensionNumbers(
            update_window_dims=(1, 2, 3),
            inserted_window_dims=(0,),
            scatter_dims_to_operand_dims=(0, 1, 2, 3),
        ),
        mode=_IN_BOUNDS,
    )


def _read(cells, offset, slot, cell, order) -> tuple[Any, jax.Array]:
    """What the transpose of `_add` reads, [N], and its slopes by the offset [N, 3].

    Line by line along the rays. On a CPU a gather of whole windows, the plain
    transpose, is several times slower.
    """
    _, rows, cols, depth = cells.shape
    first = ((slot * rows + cell[:, 0]) * cols + cell[:, 1]) * depth + cell[:, 2]

    def read(row, col):
        return jax.lax.gather(
            cells.reshape(-1),
            (first + (row * cols + col) * depth)[:, None],
            jax.lax.GatherDimensionNumbers(
                offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,)
            ),
            slice_sizes=(order + 1,),
            mode=_IN_BOUNDS,
        )

    (row, row_slope), (col, col_slope), (along, along_slope) = (
        _weigh(t, order) for t in offset.T
    )

    def blend(i):
        """Planes i of the value, and of its slopes along the columns and the rays."""
        lines = [read(i, j) for j in range(order + 1)]
        sums = [jnp.sum(line * along, axis=-1) for line in lines]
        slopes = [jnp.sum(line * along_slope, axis=-1) for line in lines]
        return (
            sum(w * s for w, s in zip(col.T, sums, strict=True)),
            sum(w * s for w, s in zip(col_slope.T, sums, strict=True)),
            sum(w * s for w, s in zip(col.T, slopes, strict=True)),
        )

    planes = [blend(i) for i in range(order + 1)]
    value, by_col, by_depth = (
        sum(w * part for w, part in zip(row.T, parts, strict=True))
        for parts in zip(*planes, strict=True)
    )
    by_row = sum(w * p[0] for w, p in zip(row_slope.T, planes, strict=True))
    return value, jnp.stack([by_row, by_col, by_depth], axis=-1)


def _weigh(offset: jax.Array, order: int) -> tuple[jax.Array, jax.Array]:
    """Weights [N, order + 1] of the cells 0, 1, ..., and their slopes by the offset."""
    if order == 1:
        # Exact near both cells, where 1 - |t| of the farther one would round.
        t, is_below, is_above = offset, offset < 0, offset >= 1
        weights = (
            jnp.where(is_below, 1 + t, jnp.where(is_above, 0, 1 - t)),
            jnp.where(is_below, 0, jnp.where(is_above, 2 - t, t)),
        )
        slopes = (
            jnp.where(is_below, 1, jnp.where(is_above, 0, -1)),
            jnp.where(is_below, 0, jnp.where(is_above, -1, 1)),
        )
        return jnp.stack(weights, -1), jnp.stack(slopes, -1).astype(offset.dtype)
    t = offset[:, None] - jnp.arange(order + 1, dtype=offset.dtype)[None]
    d = jnp.abs(t)
    zero = jnp.zeros_like(t)
    sign = jnp.sign(t)
    if order == 2:
        inner, outer = 0.75 - t * t, 0.5 * (1.5 - d) ** 2
        weight = jnp.where(d < 0.5, inner, jnp.where(d < 1.5, outer, zero))
        inner, outer = -2 * t, -sign * (1.5 - d)
        return weight, jnp.where(d < 0.5, inner, jnp.where(d < 1.5, outer, zero))
    inner, outer = 2 / 3 - t * t * (1 - 0.5 * d), (2 - d) ** 3 / 6
    weight = jnp.where(d < 1, inner, jnp.where(d < 2, outer, zero))
    inner, outer = t * (1.5 * d - 2), -0.5 * sign * (2 - d) ** 2
    return weight, jnp.where(d < 1, inner, jnp.where(d < 2, outer, zero))


def narrow(sigma: jax.Array, order: int) -> jax.Array:
    """The sigma to smooth with, () in voxels: √(σ² - (order + 1)/12).

    The spline has the variance (order + 1)/12 of its own. Where sigma is below that,
    nothing is smoothed. Order 1 is left as it is.
    """
    if order == 1:
        return sigma
    own = find_least(order)
    is_wider = sigma > own * 1.001  # no slope is infinite
    safe = jnp.where(is_wider, sigma, 1)
    return jnp.where(is_wider, jnp.sqrt((safe - own) * (safe + own)), 0)


def find_least(order: int) -> float:
    """Standard deviation of a spline in voxels, the least that it can draw."""
    return ((order + 1) / 12) ** 0.5
