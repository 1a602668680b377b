"""Sums over points in tiles of pixels: the loop of the basic method.

A volume is built tile by tile (a square of pixels with all cells along their rays),
each from the points that reach the tile, a chunk at a time. So the cost grows with the
cells that the points cover instead of N·D³, and memory holds one chunk. The derivative
runs the same loop and keeps nothing from the forward pass.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

SIDE = 8  # pixels of a tile along each axis (measured: 4 and 16 are slower)
_BLOCK = 64  # points whose running count is one row of a matrix product


class Points(NamedTuple):
    """Parameters of the densities of N points; each field is a tree of floats.

    Attributes:
      whole: leaves [N, ...], the same in every tile.
      by_row: leaves [N, rows, ...], of which a tile gets its own SIDE rows.
      by_col: leaves [N, cols, ...], likewise.
    """

    whole: Any
    by_row: Any
    by_col: Any


@functools.partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2, 3))
def sum_in_tiles(
    density: Callable,
    is_reached: Callable,
    shape: tuple[int, int, int],
    chunk: int,
    points: Points,
    places: Any,
) -> jax.Array:
    """Sum points' densities over a volume.

    Args:
      density: function (`Points` of one chunk and tile, first row and column [2]) ->
        [V, SIDE, SIDE, depth], their summed density in the tile; static. A point whose
        parameters are all zero must add nothing.
      is_reached: function (`places`, first row and column [2]) -> [N] bool, the points
        that add to a tile; static.
      shape: (rows, cols, depth), static.
      chunk: how many points are added at once, static.
      points: parameters for `density`.
      places: argument of `is_reached`, a tree of floats; without gradient.

    Returns:
      [V, rows, cols, depth].
    """
    points = _block(points, shape)

    def sum_chunk(index, corner):
        return density(_take_points(points, index, corner), corner)

    start = jax.eval_shape(
        sum_chunk, jnp.zeros(chunk, jnp.int32), jnp.zeros(2, jnp.int32)
    )

    def sum_tile(corner):
        order, count = find_points(is_reached(places, corner))

        def add_chunk(i, total):
            return total + sum_chunk(_take_index(order, count, i, chunk), corner)

        total = jnp.zeros(start.shape, start.dtype)
        return jax.lax.fori_loop(0, _count_chunks(count, chunk), add_chunk, total)

    return _join_tiles(jax.lax.map(sum_tile, _list_corners(shape)), shape)


def _sum_forward(density, is_reached, shape, chunk, points, places):
    volume = sum_in_tiles(density, is_reached, shape, chunk, points, places)
    return volume, (points, places)


def _sum_backward(density, is_reached, shape, chunk, residuals, cotangent):
    points, places = residuals
    points, unblock = jax.vjp(lambda p: _block(p, shape), points)

    def add_tile(grads, tile):
        corner, tile_cotangent = tile
        order, count = find_points(is_reached(places, corner))

        def add_chunk(i, grads):
            index = _take_index(order, count, i, chunk)
            part = _take_points(points, index, corner)
            _, pull_back = jax.vjp(lambda p: density(p, corner), part)
            return _add_points(grads, pull_back(tile_cotangent)[0], index, corner)

        chunks = _count_chunks(count, chunk)
        return jax.lax.fori_loop(0, chunks, add_chunk, grads), None

    zeros = jax.tree.map(jnp.zeros_like, points)
    tiles = _split_tiles(cotangent, shape)
    grads, _ = jax.lax.scan(add_tile, zeros, (_list_corners(shape), tiles))
    return *unblock(grads), None


sum_in_tiles.defvjp(_sum_forward, _sum_backward)


def _block(points, shape):
    """Split the axes of rows and columns into tiles: [N + 1, tiles, SIDE, ...].

    The last point, all zeros, fills up chunks that are not full.
    """

    def split(leaf, count):
        padding = [(0, 0)] * leaf.ndim
        padding[0], padding[1] = (0, 1), (0, count * SIDE - leaf.shape[1])
        leaf = jnp.pad(leaf, padding)
        return leaf.reshape(leaf.shape[0], count, SIDE, *leaf.shape[2:])

    down, across = _count_tiles(shape)
    return Points(
        jax.tree.map(
            lambda a: jnp.pad(a, [(0, 1)] + [(0, 0)] * (a.ndim - 1)), points.whole
        ),
        jax.tree.map(lambda a: split(a, down), points.by_row),
        jax.tree.map(lambda a: split(a, across), points.by_col),
    )


def _take_points(points, index, corner):
    """A chunk of points, with the rows and columns of one tile."""
    row, col = corner[0] // SIDE, corner[1] // SIDE
    known = {"mode": "promise_in_bounds"}
    return Points(
        jax.tree.map(lambda a: a.at[index].get(**known), points.whole),
        jax.tree.map(lambda a: a.at[index, row].get(**known), points.by_row),
        jax.tree.map(lambda a: a.at[index, col].get(**known), points.by_col),
    )


def _add_points(grads, part, index, corner):
    """Add the transpose of `_take_points` to the gradients."""
    row, col = corner[0] // SIDE, corner[1] // SIDE
    known = {"mode": "promise_in_bounds"}

    def add(grads, part, *place):
        return jax.tree.map(
            lambda g, p: g.at[(index, *place)].add(p, **known), grads, part
        )

    return Points(
        add(grads.whole, part.whole),
        add(grads.by_row, part.by_row, row),
        add(grads.by_col, part.by_col, col),
    )


def _count_tiles(shape):
    return math.ceil(shape[0] / SIDE), math.ceil(shape[1] / SIDE)


def _list_corners(shape):
    """First row and column of each tile, [T, 2] int32."""
    down, across = _count_tiles(shape)
    rows, cols = jnp.meshgrid(
        jnp.arange(down) * SIDE, jnp.arange(across) * SIDE, indexing="ij"
    )
    return jnp.stack([rows.ravel(), cols.ravel()], axis=-1)


def _join_tiles(tiles, shape):
    """[T, V, SIDE, SIDE, depth] to [V, rows, cols, depth]."""
    down, across = _count_tiles(shape)
    channels = tiles.shape[1]
    tiles = tiles.reshape(down, across, channels, SIDE, SIDE, -1)
    volume = tiles.transpose(2, 0, 3, 1, 4, 5)
    volume = volume.reshape(channels, down * SIDE, across * SIDE, -1)
    return volume[:, : shape[0], : shape[1]]


def _split_tiles(volume, shape):
    """The transpose of `_join_tiles`."""
    down, across = _count_tiles(shape)
    padding = ((0, 0), (0, down * SIDE - shape[0]), (0, across * SIDE - shape[1]))
    volume = jnp.pad(volume, (*padding, (0, 0)))
    tiles = volume.reshape(-1, down, SIDE, across, SIDE, shape[2])
    return tiles.transpose(1, 3, 0, 2, 4, 5).reshape(
        down * across, -1, SIDE, SIDE, shape[2]
    )


def find_gap(centers: jax.Array, first: jax.Array) -> jax.Array:
    """Distance along an axis of points [N] from a tile's cells; 0 for those inside."""
    last = first + SIDE - 1
    return jnp.maximum(jnp.maximum(first - centers, centers - last), 0)


def find_points(reaches: jax.Array) -> tuple[jax.Array, jax.Array]:
    """List the points that reach a tile.

    As `jnp.nonzero` with a fixed size, in a quarter of its time on a CPU: the running
    count is taken block by block, as a product with a triangle of ones. Counts that
    small are exact in every precision.

    Args:
      reaches: [N] bool.

    Returns:
      ([N] int32, the indices of those points and then N in the free places; how many
      they are).
    """
    count = len(reaches)
    blocks = jnp.pad(reaches, (0, -count % _BLOCK)).reshape(-1, _BLOCK)
    ones = jnp.triu(jnp.ones((_BLOCK, _BLOCK), jnp.float32))
    within = (blocks.astype(jnp.float32) @ ones).astype(jnp.int32)
    sizes = within[:, -1]
    ranks = (within + (jnp.cumsum(sizes) - sizes)[:, None]).ravel()[:count]
    index = jnp.arange(count, dtype=jnp.int32)
    order = jnp.full(count, count, jnp.int32)
    order = order.at[jnp.where(reaches, ranks - 1, count)].set(index, mode="drop")
    return order, jnp.sum(sizes)


def _count_chunks(count, chunk):
    return (count + chunk - 1) // chunk


def _take_index(order, count, i, chunk):
    """Indices of the i-th chunk of a tile's points; N in its free places."""
    place = i * chunk + jnp.arange(chunk)
    total = order.shape[0]
    return jnp.where(place < count, order[jnp.minimum(place, total - 1)], total)
