"""Images in blocks: along a ray inside of each block, then over its blocks.

The blocks of a column come one after the other, nearest first. So what lies before a
block is a product over a part of a run of blocks. Empty space lets every ray through
and takes no part.

Blocks are [M, 8, 8, 8] as (depth, row, col), columns of blocks [num, 8, 8].
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render.blocks.filling import sum_densities
from dpc_jax.render.blocks.touched import BLOCK, divide, find_blocks, find_depths
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.termination import Rays
from dpc_jax.render.volume import Scene, clip_unit, map_channels

_IN_BOUNDS = "promise_in_bounds"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Columns:
    """Which column of blocks each of M blocks belongs to."""

    index: jax.Array  # [M], `num` for a free slot
    num: int = dataclasses.field(metadata={"static": True})
    most: int = dataclasses.field(metadata={"static": True})  # blocks in a column

    def is_next(self, step: int | jax.Array) -> tuple[jax.Array, jax.Array]:
        """([M] slot `step` away, [M] bool whether it is of the same column)."""
        slot = jnp.arange(len(self.index)) + step
        safe = slot.clip(0, len(self.index) - 1)
        return safe, (slot == safe) & (self.index[safe] == self.index)

    def add_up(self, values: jax.Array) -> jax.Array:
        """Sum values [M, ...] of blocks in each column, [num, ...]."""
        sums = jnp.zeros((self.num + 1, *values.shape[1:]), values.dtype)
        return sums.at[self.index].add(values, mode=_IN_BOUNDS)[:-1]

    def read(self, values: jax.Array) -> jax.Array:
        """Values [num, ...] of each block's column, [M, ...]; 0 for a free slot."""
        extra = jnp.zeros((1, *values.shape[1:]), values.dtype)
        return jnp.concatenate([values, extra])[self.index]


def render_blocks(
    scene: Scene,
    colors: jax.Array | None,
    camera: Camera,
    grid: VoxelGrid,
    signals: tuple[str, ...],
    background: tuple[chex.Numeric, chex.Numeric],
    max_blocks: int,
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Eq. 3 to 5 for one sigma, without the space that no point reaches.

    Arguments as of `project`, with room for `max_blocks` blocks (static).

    Returns:
      (images by the name of their signal, () bool whether they are right: the blocks
      found room, and the smoothing reaches no further than the next block).
    """
    shape = grid.shape
    blocks = find_blocks(scene, shape, max_blocks)
    is_right = blocks.count <= max_blocks
    fill = functools.partial(sum_densities, scene, blocks=blocks, shape=shape)
    density = fill(scene.mass)
    occupancy = clip_unit(density)
    rows, cols, depth = divide(shape)
    columns = Columns(blocks.ids // depth, rows * cols, depth)
    images = {}
    if "silhouette" in signals:
        united = opacity(occupancy, columns)
        images["silhouette"] = lay_out_image(united, shape)
    if set(signals) == {"silhouette"}:
        return images, is_right

    found = end_rays(occupancy, columns)
    behind = lay_out_image(found.background, shape)
    background_depth, background_color = background
    if "depth" in signals:
        cells = find_depths(blocks.ids, shape).clip(0, shape[2] - 1)
        depths = grid.depths(camera, density.dtype)[cells][:, :, None, None]
        ahead = columns.add_up(jnp.sum(found.ends * depths, axis=1))
        beyond = behind * jnp.asarray(background_depth, density.dtype)
        images["depth"] = lay_out_image(ahead, shape) + beyond
    if colors is not None:
        weight = found.reached / jnp.where(density > 1, density, 1)

        def sum_channel(channel):
            return columns.add_up(jnp.sum(weight * fill(scene.mass * channel), axis=1))

        ahead = jnp.moveaxis(map_channels(sum_channel, colors), 0, -1)
        color = jnp.asarray(background_color, density.dtype).reshape(1, 1, -1)
        beyond = behind[..., None] * color
        images["color"] = lay_out_image(ahead, shape) + beyond
    return images, is_right


def opacity(occupancy: jax.Array, columns: Columns) -> jax.Array:
    """1 - Π(1 - o) of all rays, as `termination.opacity` of the dense volume."""
    united = occupancy
    while united.shape[1] > 1:
        half = united.shape[1] // 2
        united = _unite(united[:, :half], united[:, half:])
    return _unite_columns(united[:, 0], columns)


def _unite(near, far):
    return near + far * (1 - near)  # 1 - (1 - a)(1 - b), and nothing cancels


@jax.custom_vjp
def _unite_columns(united, columns):
    """1 - Π(1 - u) over the blocks [M, 8, 8] of each column."""
    runs = _scan(_unite, united, columns, -1)
    _, goes_on = columns.is_next(1)
    return columns.add_up(jnp.where(_spread(goes_on), 0, runs))


def _unite_columns_forward(united, columns):
    return _unite_columns(united, columns), (united, columns)


def _unite_columns_backward(residuals, cotangent):
    """Product over the other blocks: those before and those after."""
    united, columns = residuals
    clear = 1 - united
    others = _pass_before(clear, columns, -1) * _pass_before(clear, columns, 1)
    return columns.read(cotangent) * others, None


_unite_columns.defvjp(_unite_columns_forward, _unite_columns_backward)


def _scan(combine: Callable, values: Any, columns: Columns, step: int) -> Any:
    """Combine values [M, 8, 8] of each block with those of all before it (-1) or after.

    By doubling, in a loop: unrolled, XLA computes each turn again for both its readers.
    """

    def double(turn, values):
        slots, is_joined = columns.is_next(step * 2**turn)
        joined = combine(jax.tree.map(lambda v: v[slots], values), values)
        return jax.tree.map(
            lambda new, old: jnp.where(_spread(is_joined), new, old), joined, values
        )

    turns = (columns.most - 1).bit_length()
    return jax.lax.fori_loop(0, turns, double, values)


def _pass_before(clear, columns, step):
    """Product of `clear` over the blocks before (-1) or after (1) each one."""
    slots, is_joined = columns.is_next(step)
    products = _scan(jnp.multiply, clear, columns, step)
    return jnp.where(_spread(is_joined), products[slots], 1)


def _spread(flags):
    return flags[:, None, None]


def end_rays(occupancy: jax.Array, columns: Columns) -> Rays:
    """Eq. 4 of the paper: ray termination, r_k = o_k·Π_{u<k}(1 - o_u).

    Of the cells [M, 8, 8, 8], with the background of the columns [num, 8, 8].
    """
    clear = 1 - occupancy
    passed = [jnp.ones_like(clear[:, 0])]
    for k in range(BLOCK):
        passed.append(passed[-1] * clear[:, k])
    before, background = _pass_columns(passed[-1], columns)
    reached = before[:, None] * jnp.stack(passed[:-1], axis=1)
    return Rays(occupancy * reached, background, reached)


@jax.custom_vjp
def _pass_columns(clear, columns):
    """([M, 8, 8] product over the blocks before each one, [num, 8, 8] over all)."""
    before = _pass_before(clear, columns, -1)
    _, goes_on = columns.is_next(1)
    is_empty = jnp.ones(columns.num + 1, clear.dtype)
    is_empty = is_empty.at[columns.index].set(0, mode=_IN_BOUNDS)[:-1]
    whole = columns.add_up(jnp.where(_spread(goes_on), 0, before * clear))
    return before, whole + _spread(is_empty)


def _pass_columns_forward(clear, columns):
    before, whole = _pass_columns(clear, columns)
    return (before, whole), (clear, before, columns)


def _pass_columns_backward(residuals, cotangents):
    """By the recursion s_j = c_{j+1} + T_{j+1}·s_{j+1}, exact where a T is zero.

    c is the cotangent of the products before a block, and s of the last block that of
    the whole column. The derivative with respect to T_j is s_j times the product before
    it. The recursion's steps are combined in pairs, as maps s → a + b·s.
    """
    clear, before, columns = residuals
    slots, goes_on = columns.is_next(1)
    goes_on = _spread(goes_on)
    to_before, to_whole = cotangents
    add = jnp.where(goes_on, to_before[slots], columns.read(to_whole))
    times = jnp.where(goes_on, clear[slots], 0)

    def combine(farther, nearer):
        (a_far, b_far), (a, b) = farther, nearer
        return a + b * a_far, b * b_far

    sums, _ = _scan(combine, (add, times), columns, 1)
    return before * sums, None


_pass_columns.defvjp(_pass_columns_forward, _pass_columns_backward)


def lay_out_image(columns: jax.Array, shape: tuple[int, int, int]) -> jax.Array:
    """[rows, cols, ...] from columns of blocks [num, 8, 8, ...]."""
    counts, rest = divide(shape), columns.shape[3:]
    image = columns.reshape(*counts[:2], BLOCK, BLOCK, *rest)
    image = jnp.moveaxis(image, 2, 1)  # [blocks, row, blocks, col, ...]
    image = image.reshape(counts[0] * BLOCK, counts[1] * BLOCK, *rest)
    return image[: shape[0], : shape[1]]
