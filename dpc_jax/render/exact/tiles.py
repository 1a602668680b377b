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
_BLOCK = 64  # points whose running count is one row of a matrix product


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


@functools.partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2, 3))
def sum_in_tiles(density, is_reached, shape, chunk, points, places):
    """Sum points' densities over a volume.

    Args:
      density: function (`Points` of one chunk and tile, first row and column [2]) ->
        [V, SIDE, SIDE, depth], their summed density there; static. It must be zero for
        a point of which all parameters are zero.
      is_reached: function (`places`, first row and column [2]) -> [N] bool, the points
        whose density a tile needs; static.
      shape: (rows, cols, depth), static.
      chunk: points at once, static.
      points: the densities' parameters.
      places: what `is_reached` looks at, a tree of floats; without gradient.

    Returns:
      [V, rows, cols, depth].
    """
    points = _block(points, shape)
    start = _find_density_shape(density, points, chunk)

    def sum_tile(corner):
        order, count = find_points(is_reached(places, corner))

        def add_chunk(i, total):
            index = _take_index(order, count, i, chunk)
            return total + density(_take_points(points, index, corner), corner)

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

    The last point is all zeros, for the free places of a chunk.
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
    """A chunk of points as a tile needs them."""
    row, col = corner[0] // SIDE, corner[1] // SIDE
    known = {"mode": "promise_in_bounds"}
    return Points(
        jax.tree.map(lambda a: a.at[index].get(**known), points.whole),
        jax.tree.map(lambda a: a.at[index, row].get(**known), points.by_row),
        jax.tree.map(lambda a: a.at[index, col].get(**known), points.by_col),
    )


def _add_points(grads, part, index, corner):
    """The transpose of `_take_points`, added to what is there."""
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


def find_gap(centers, first):
    """Distance of points [N] from a tile's cells along an axis, 0 between them."""
    last = first + SIDE - 1
    return jnp.maximum(jnp.maximum(first - centers, centers - last), 0)


def find_points(reaches):
    """Indices [N] of the points that reach a tile, first, and how many they are.

    As `jnp.nonzero`, at a quarter of its time on a CPU: the running count is summed in
    blocks, by a product with a triangle of ones. It is exact in every precision.
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
    """Indices of the i-th chunk of a tile's points, N where it is not full."""
    place = i * chunk + jnp.arange(chunk)
    total = order.shape[0]
    return jnp.where(place < count, order[jnp.minimum(place, total - 1)], total)
