"""Points to cells by B-splines: along each axis to `order` + 1 of them.

Order 1 fills blocks; the whole volume has `splatting.splat`, whose sums every trained
figure of the project rests on to the last digit.

The derivative of an image with respect to a point is as smooth as the spline: constant
inside of a cell for order 1, which is the trilinear method; linear for 2; quadratic
for 3.
"""

import functools

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

ORDERS = {"trilinear": 1, "quadratic": 2, "cubic": 3}
_IN_BOUNDS = "promise_in_bounds"


def find_first(
    coordinates: jax.Array, shape: tuple[int, int, int], order: int
) -> jax.Array:
    """The first cell along each axis that a point goes to, [N, 3] int32.

    All `order` + 1 are inside of the volume. A point near to a side gives nothing to
    those that its spline does not reach, and what falls outside is lost.
    """
    first = jnp.floor(coordinates + 0.5) - 1 if order == 2 else jnp.floor(coordinates)
    first = first - 1 if order == 3 else first
    most = jnp.array(shape)[None] - (order + 1)
    return jnp.clip(first, 0, most.astype(first.dtype)).astype(jnp.int32)


def narrow(sigma: jax.Array, order: int) -> jax.Array:
    """The sigma to smooth with, () in voxels: √(σ² - (order + 1)/12).

    The spline has the variance (order + 1)/12 of its own. Where sigma is below that,
    nothing is smoothed. Order 1 is left as it is (`splatting.compensate_widening`).
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


def scatter(
    offset: jax.Array,
    values: jax.Array,
    slot: jax.Array,
    cell: jax.Array,
    order: int,
    shape: tuple[int, int, int, int],
) -> jax.Array:
    """Add up the points' splines in M stores of cells.

    Args:
      offset: [N, 3], of a point from its first cell.
      values: [N], what each adds in total.
      slot: [N] int32, its store.
      cell: [N, 3] int32, its first cell in the store.
      order: of the spline, static.
      shape: of the stores, (M, rows, cols, depth), static.

    Returns:
      An array of that shape. On a kink of order 1 the derivative is that towards the
      higher index.
    """
    return _scatter(offset, values, slot, cell, order, shape)


@functools.partial(jax.custom_vjp, nondiff_argnums=(4, 5))
def _scatter(offset, values, slot, cell, order, shape):
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


def _scatter_forward(offset, values, slot, cell, order, shape):
    cells = _scatter(offset, values, slot, cell, order, shape)
    return cells, (offset, values, slot, cell)


def _scatter_backward(order, shape, residuals, cotangent):
    """Read the cotangent in the cells of each point, line by line along the rays."""
    offset, values, slot, cell = residuals
    _, rows, cols, depth = shape
    first = ((slot * rows + cell[:, 0]) * cols + cell[:, 1]) * depth + cell[:, 2]

    def read(row, col):
        return jax.lax.gather(
            cotangent.reshape(-1),
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
    by_offset = jnp.stack([by_row, by_col, by_depth], axis=-1)
    return values[:, None] * by_offset, value, None, None


_scatter.defvjp(_scatter_forward, _scatter_backward)


def splat(
    coordinates: jax.Array, values: ArrayLike, shape: tuple[int, int, int], order: int
) -> jax.Array:
    """Points [N, 3] inside of a volume to its cells, [rows, cols, depth]."""
    first = find_first(jax.lax.stop_gradient(coordinates), shape, order)
    slot = jnp.zeros(first.shape[0], jnp.int32)
    values = jnp.asarray(values, coordinates.dtype)
    return scatter(coordinates - first, values, slot, first, order, (1, *shape))[0]
