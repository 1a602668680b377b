"""Which blocks of 8³ cells the points and their smoothing reach.

An object's surface passes through few of them: through a quarter at 64³, a tenth at
256³, a fiftieth at 1024³. Blocks are numbered like cells, depth fastest, so that those
of a column come one after the other, nearest first.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.render import kernels
from dpc_jax.render.exact.tiles import find_points
from dpc_jax.render.fast import splatting
from dpc_jax.render.volume import Scene

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


def find_blocks(scene: Scene, shape: tuple[int, int, int], room: int) -> Blocks:
    """The blocks that the splines of points reach, and their smoothing.

    There is room for `room` of them (static). Where the smoothing reaches beyond the
    next block, the count is that of all blocks.
    """
    order = splatting.ORDERS[scene.method]
    coordinates, sigma = jax.lax.stop_gradient(
        (scene.coordinates, splatting.narrow(jnp.asarray(scene.sigma), order))
    )
    counts = divide(shape)
    total = int(np.prod(counts))
    first = splatting.find_first(coordinates, shape, order)
    block, cell = first // BLOCK, first % BLOCK
    home = jnp.where(scene.is_inside, number(block, counts), total)
    # How many cells beyond a point's own the smoothing reaches.
    reach = jnp.floor(kernels.find_half_width(sigma, coordinates.dtype))
    is_narrow = reach <= BLOCK - order  # not NaN
    reach = jnp.where(is_narrow, reach, BLOCK).astype(jnp.int32)
    # Two steps: the blocks that hold points are few, and only for them is it asked
    # which neighbours their points reach.
    homes = _index(home, total, room)
    kinds = (cell < reach) + 2 * (cell + order + reach >= BLOCK)
    kind = (kinds[:, 0] * 4 + kinds[:, 1]) * 4 + kinds[:, 2]
    seen = jnp.zeros((homes.ids.shape[0] + 1) * 64, jnp.float32)
    seen = seen.at[homes.slots[home] * 64 + kind].set(1, mode=_IN_BOUNDS)
    steps = jnp.matmul(seen.reshape(-1, 64)[:-1], _REACHED.astype(np.float32)) > 0
    places = _place(homes.ids, counts)[:, None] + _STEPS[None]
    limits = jnp.array(counts)[None, None]
    is_there = jnp.all((places >= 0) & (places < limits), axis=-1)
    is_there &= steps & (homes.ids < total)[:, None]
    touched = jnp.where(is_there, number(places, counts), total)
    found = _index(touched.reshape(-1), total, room)
    # Where the blocks with points alone are too many, their neighbours are not known.
    count = jnp.maximum(found.count, homes.count)
    return found._replace(count=jnp.where(is_narrow, count, total))


def find_depths(ids: jax.Array, shape: tuple[int, int, int]) -> jax.Array:
    """Index along a ray of each layer of cells of blocks [M], [M, 8]."""
    first = ids % divide(shape)[2] * BLOCK
    return first[:, None] + jnp.arange(BLOCK)[None]


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


def number(places: jax.Array, counts: tuple[int, int, int]) -> jax.Array:
    """Numbers of the blocks at places [..., 3] among the blocks."""
    return (places[..., 0] * counts[1] + places[..., 1]) * counts[2] + places[..., 2]


def _place(numbers, counts):
    _, cols, depth = counts
    rest = numbers // depth
    return jnp.stack([rest // cols, rest % cols, numbers % depth], axis=-1)


def _index(numbers, total, room):
    """The blocks of these numbers; `total` stands for none."""
    marks = jnp.zeros(total + 1, bool).at[numbers].set(True, mode=_IN_BOUNDS)
    found, count = find_points(marks[:total])
    ids = found[:room]
    slots = jnp.full(total + 1, room, jnp.int32)
    slots = slots.at[ids].set(jnp.arange(room, dtype=jnp.int32), mode=_IN_BOUNDS)
    return Blocks(ids, slots.at[total].set(room), count)
