"""Trilinear splatting: points to a volume, the fast method's first step."""

import functools
import itertools

import chex
import jax
import jax.numpy as jnp


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def splat(
    coordinates: chex.Array,
    values: chex.Array,
    shape: tuple[int, int, int],
) -> chex.Array:
    """Spread each point's value over its eight neighbouring cells.

    Appendix "Differentiable point cloud projection", the fast implementation.

    Args:
      coordinates: [N, 3] continuous (row, col, depth) index, cell centres at integers.
        A point outside the volume, beyond [-1/2, D - 1/2] along an axis, leaves no
        trace; of a point inside, the share that falls on cells outside is lost.
      values: [N], what each point adds in total.
      shape: (rows, cols, depth), static.

    Returns:
      [rows, cols, depth]. Each axis is linear between cell centres, so the derivative
      jumps at them; there the one towards the higher index is taken.
    """
    chex.assert_shape(coordinates, (None, 3))
    chex.assert_shape(values, (coordinates.shape[0],))
    base, weights, is_inside = _find_neighbours(coordinates, shape)
    row, col, depth = weights
    block = row[:, :, None, None] * col[:, None, :, None] * depth[:, None, None, :]
    updates = jnp.where(is_inside, values, 0)[:, None, None, None] * block
    # One cell of margin takes what falls outside, so no index is negative (it would
    # wrap to the far side) and each point is one 2×2×2 window.
    padded = jax.lax.scatter_add(
        jnp.zeros([s + 2 for s in shape], values.dtype),
        base + 1,
        updates,
        jax.lax.ScatterDimensionNumbers(
            update_window_dims=(1, 2, 3),
            inserted_window_dims=(),
            scatter_dims_to_operand_dims=(0, 1, 2),
        ),
        mode="promise_in_bounds",
    )
    return padded[1:-1, 1:-1, 1:-1]


def _find_neighbours(coordinates, shape):
    """Lower corner [N, 3] of each point's cell, its two weights along each axis."""
    sizes = jnp.array(shape, coordinates.dtype)
    is_inside = jnp.all((coordinates >= -0.5) & (coordinates <= sizes - 0.5), axis=-1)
    safe = jnp.where(is_inside[:, None], coordinates, 0)
    base = jnp.floor(safe)
    fraction = safe - base
    weights = [jnp.stack([1 - f, f], axis=-1) for f in fraction.T]
    return base.astype(jnp.int32), weights, is_inside


def _splat_forward(coordinates, values, shape):
    return splat(coordinates, values, shape), (coordinates, values)


def _splat_backward(shape, residuals, cotangent):
    """Read the cotangent at the eight corners: eight plain gathers.

    The transpose of the windowed scatter, a windowed gather, is several times slower
    on a CPU.
    """
    coordinates, values = residuals
    base, weights, is_inside = _find_neighbours(coordinates, shape)
    padded = jnp.pad(cotangent, 1)
    rows, cols, depth = padded.shape
    first = ((base[:, 0] + 1) * cols + base[:, 1] + 1) * depth + base[:, 2] + 1
    # Of the weights (1 - f, f) the derivatives are (-1, 1).
    value_grad, coordinate_grad = 0, [0, 0, 0]
    for corner in itertools.product((0, 1), repeat=3):
        offset = (corner[0] * cols + corner[1]) * depth + corner[2]
        read = padded.reshape(-1).at[first + offset].get(mode="promise_in_bounds")
        a, b, c = (weights[axis][:, corner[axis]] for axis in range(3))
        value_grad += read * a * b * c
        for axis, others in enumerate((b * c, a * c, a * b)):
            sign = 1 if corner[axis] else -1
            coordinate_grad[axis] += sign * read * others
    mask = jnp.where(is_inside, values, 0)
    grads = jnp.stack(coordinate_grad, axis=-1) * mask[:, None]
    return grads, jnp.where(is_inside, value_grad, 0)


splat.defvjp(_splat_forward, _splat_backward)
