"""Which blocks of 8³ cells the points and their smoothing reach.

An object's surface passes through few of them: through a quarter at 64³, a tenth at
256³, a fiftieth at 1024³. Blocks are numbered like cells, depth fastest, so that those
of a column come one after the other, nearest first.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from dpc_jax.render import kernels
from dpc_jax.render.exact.tiles import find_points
from dpc_jax.render.fast import splatting

BLOCK = 8  # cells along a side
_IN_BOUNDS = "promise_in_bounds"
# The 27 steps to a block and its neighbours. Along each axis a point takes that to the
# block before, if its kind has the bit 1, and that to the one after for the bit 2.
_STEPS = np.indices((3, 3, 3)).reshape(3, 27).T - 1
_KINDS = np.indices((4, 4, 4)).reshape(3, 64).T
_TAKEN = np.stack([_KINDS & 1 > 0, _KINDS >= 0, _KINDS & 2 > 0], -1)
# [64, 27], 1 for the steps of each kind.
_REACHED = np.all([_TAKEN[:, a, _STEPS[:, a] + 1] for a in range(3)], axis=0)


class Blocks(NamedTuple):
    """The touched blocks, and where to find them; M is the room there is for them."""

    ids: jax.Array  # [M] ascending numbers of blocks; `total` where a slot is free
    slots: jax.Array  # [total + 1] slot of each block, M where it has none
    count: jax.Array  # () blocks touched, more than M where the room does not do


def divide(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """How many blocks a grid has along each axis; the last may stand out."""
    rows, cols, depth = (-(-side // BLOCK) for side in shape)
    return rows, cols, depth


def find_reach(sigma: jax.Array, dtype: DTypeLike, order: int) -> jax.Array:
    """How many cells beyond a point's own the smoothing reaches, () int32.

    With them it may reach one block further along each axis: 8 - `order` cells. The
    result is at most one more.
    """
    reach = jnp.floor(kernels.find_half_width(sigma, dtype))
    most = BLOCK - order
    # NaN and infinity are as wide as can be.
    return jnp.where(reach <= most, reach, most + 1).astype(jnp.int32)


def is_narrow(sigma: jax.Array, dtype: DTypeLike, order: int) -> jax.Array:
    """Whether the smoothing reaches no further than the next block, () bool."""
    return find_reach(sigma, dtype, order) <= BLOCK - order


def find_blocks(
    coordinates: jax.Array,
    is_inside: jax.Array,
    sigma: jax.Array,
    shape: tuple[int, int, int],
    order: int,
    room: int,
) -> Blocks:
    """The blocks that points [N, 3] reach, `order` + 1 cells of each and the smoothing.

    There is room for `room` of them (static).
    """
    counts = divide(shape)
    total = int(np.prod(counts))
    first = splatting.find_first(coordinates, shape, order)
    block, cell = first // BLOCK, first % BLOCK
    number = jnp.where(is_inside, _number(block, counts), total)
    # Two steps: the blocks that hold points are few, and only for them is it asked
    # which neighbours their points reach.
    homes = _index(_mark(number, total), room)
    reach = find_reach(sigma, coordinates.dtype, order)
    kinds = (cell < reach) + 2 * (cell + order + reach >= BLOCK)
    kind = (kinds[:, 0] * 4 + kinds[:, 1]) * 4 + kinds[:, 2]
    seen = jnp.zeros((homes.ids.shape[0] + 1) * 64, jnp.float32)
    seen = seen.at[homes.slots[number] * 64 + kind].set(1, mode=_IN_BOUNDS)
    steps = (
        jnp.matmul(seen.reshape(-1, 64)[:-1], _REACHED.astype(np.float32)) > 0
    )  # [M, 27]
    places = _place(homes.ids, counts)[:, None] + _STEPS[None]
    is_there = jnp.all(
        (places >= 0) & (places < jnp.array(counts)[None, None]), axis=-1
    )
    is_there &= steps & (homes.ids < total)[:, None]
    touched = jnp.where(is_there, _number(places, counts), total)
    found = _index(_mark(touched.reshape(-1), total), room)
    # Where the blocks with points alone are too many, their neighbours are not known.
    return found._replace(count=jnp.maximum(found.count, homes.count))


def find_slots(
    first: jax.Array, blocks: Blocks, counts: tuple[int, int, int]
) -> tuple[jax.Array, jax.Array]:
    """([N] slot of the block of a cell, M where it has none; [N, 3] cell in it)."""
    return blocks.slots[_number(first // BLOCK, counts)], first % BLOCK


def find_neighbours(
    blocks: Blocks, counts: tuple[int, int, int], axis: int
) -> tuple[jax.Array, jax.Array]:
    """[M] slots of the blocks before and after along an axis; M where there is none."""
    total = int(np.prod(counts))
    place = _place(blocks.ids, counts)[:, axis]
    step = int(np.prod(counts[axis + 1 :]))
    is_used = blocks.ids < total
    before = jnp.where(is_used & (place > 0), blocks.ids - step, total)
    after = jnp.where(is_used & (place < counts[axis] - 1), blocks.ids + step, total)
    return blocks.slots[before], blocks.slots[after]


def _number(places, counts):
    return (places[..., 0] * counts[1] + places[..., 1]) * counts[2] + places[..., 2]


def _place(numbers, counts):
    _, cols, depth = counts
    rest = numbers // depth
    return jnp.stack([rest // cols, rest % cols, numbers % depth], axis=-1)


def _mark(numbers, total):
    marks = jnp.zeros(total + 1, bool).at[numbers].set(True, mode=_IN_BOUNDS)
    return marks[:total]


def _index(marks, room):
    """Number the marked blocks."""
    total = len(marks)
    found, count = find_points(marks)
    ids = found[:room]
    slots = jnp.full(total + 1, room, jnp.int32)
    slots = slots.at[ids].set(jnp.arange(room, dtype=jnp.int32), mode=_IN_BOUNDS)
    return Blocks(ids, slots.at[total].set(room), count)
