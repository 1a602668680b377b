"""Sums over points in tiles of pixels: the exact methods' loop, in bounded memory.

A volume is the sum of the points' densities. It is built tile by tile (a square of
pixels, all cells along the rays), each from the points that reach the tile, a chunk at
a time. So the cost follows what the points cover, not N·D³, and memory holds one chunk.
The derivative is taken the same way: nothing is kept from the forward pass.
"""

import functools
import math
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

SIDE = 8  # pixels of a tile along each axis (measured: 4 and 16 are slower)


class Points(NamedTuple):
    """What the densities of N points depend on; any tree of floats in each field.

    Attributes:
      whole: leaves [N, ...], the same in every tile.
      by_row: leaves [N, rows, ...], of which a tile gets its own SIDE rows.
      by_col: leaves [N, cols, ...], likewise.
    """

    whole: chex.ArrayTree
    by_row: chex.ArrayTree
    by_col: chex.ArrayTree


@functools.partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2))
def sum_in_tiles(density, shape, chunk, points, intervals):
    """Sum points' densities over a volume.

    Args:
      density: function (`Points` of one chunk and tile, first row and column [2]) ->
        [V, SIDE, SIDE, depth], their summed density there; static. It must be zero for
        a point of which all parameters are zero.
      shape: (rows, cols, depth), static.
      chunk: points at once, static.
      points: the densities' parameters.
      intervals: [N, 4] float, first and last row, first and last column that a point
        reaches; without gradient.

    Returns:
      [V, rows, cols, depth].
    """
    points = _block(points, shape)
    start = _find_density_shape(density, points, chunk)

    def sum_tile(corner):
        order, count = _find_points(intervals, corner)

        def add_chunk(i, total):
            index = _take_index(order, count, i, chunk)
            return total + density(_take_points(points, index, corner), corner)

        total = jnp.zeros(start.shape, start.dtype)
        return jax.lax.fori_loop(0, _count_chunks(count, chunk), add_chunk, total)

    return _join_tiles(jax.lax.map(sum_tile, _list_corners(shape)), shape)


def _sum_forward(density, shape, chunk, points, intervals):
    volume = sum_in_tiles(density, shape, chunk, points, intervals)
    return volume, (points, intervals)


def _sum_backward(density, shape, chunk, residuals, cotangent):
    points, intervals = residuals
    points, unblock = jax.vjp(lambda p: _block(p, shape), points)

    def add_tile(grads, tile):
        corner, tile_cotangent = tile
        order, count = _find_points(intervals, corner)

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
    return *unblock(grads), jnp.zeros_like(intervals)


sum_in_tiles.defvjp(_sum_forward, _sum_backward)


def _block(points, shape):
    """Split the axes of rows and columns into tiles: [N, tiles, SIDE, ...]."""

    def split(leaf, count):
        padding = [(0, 0)] * leaf.ndim
        padding[1] = (0, count * SIDE - leaf.shape[1])
        leaf = jnp.pad(leaf, padding)
        return leaf.reshape(leaf.shape[0], count, SIDE, *leaf.shape[2:])

    down, across = _count_tiles(shape)
    return Points(
        points.whole,
        jax.tree.map(lambda a: split(a, down), points.by_row),
        jax.tree.map(lambda a: split(a, across), points.by_col),
    )


def _take_points(points, index, corner):
    """A chunk of points as a tile needs them; zeros at index N."""
    row, col = corner[0] // SIDE, corner[1] // SIDE
    fill = {"mode": "fill", "fill_value": 0}
    return Points(
        jax.tree.map(lambda a: a.at[index].get(**fill), points.whole),
        jax.tree.map(lambda a: a.at[index, row].get(**fill), points.by_row),
        jax.tree.map(lambda a: a.at[index, col].get(**fill), points.by_col),
    )


def _add_points(grads, part, index, corner):
    """The transpose of `_take_points`, added to what is there."""
    row, col = corner[0] // SIDE, corner[1] // SIDE
    drop = {"mode": "drop"}

    def add(grads, part, *place):
        return jax.tree.map(
            lambda g, p: g.at[(index, *place)].add(p, **drop), grads, part
        )

    return Points(
        add(grads.whole, part.whole),
        add(grads.by_row, part.by_row, row),
        add(grads.by_col, part.by_col, col),
    )


def _find_density_shape(density, points, chunk):
    def call(points):
        index = jnp.zeros(chunk, jnp.int32)
        corner = jnp.zeros(2, jnp.int32)
        return density(_take_points(points, index, corner), corner)

    return jax.eval_shape(call, points)


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


def _find_points(intervals, corner):
    """Indices [N] of the points that reach a tile, first, and how many they are."""
    first_row, last_row, first_col, last_col = intervals.T
    row, col = corner[0], corner[1]
    reaches = (first_row < row + SIDE) & (last_row >= row)
    reaches &= (first_col < col + SIDE) & (last_col >= col)
    count = intervals.shape[0]
    (order,) = jnp.nonzero(reaches, size=count, fill_value=count)
    return order, jnp.sum(reaches)


def _count_chunks(count, chunk):
    return (count + chunk - 1) // chunk


def _take_index(order, count, i, chunk):
    """Indices of the i-th chunk of a tile's points, N where it is not full."""
    place = i * chunk + jnp.arange(chunk)
    total = order.shape[0]
    return jnp.where(place < count, order[jnp.minimum(place, total - 1)], total)
