"""Eq. 3 in blocks: points to cells near them, then one smoothing along each axis."""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.render import kernels
from dpc_jax.render.blocks import touched
from dpc_jax.render.blocks.touched import BLOCK, Blocks
from dpc_jax.render.fast import splatting
from dpc_jax.render.volume import Scene

# An axis is smoothed as the last one, where a matrix product takes a tenth of the time.
# Which axis, and the order in which those of a block are left for the next one.
_PASSES = ((2, (0, 3, 1, 2)), (1, (0, 3, 1, 2)), (0, (0, 2, 3, 1)))


def sum_densities(
    scene: Scene, mass: jax.Array, blocks: Blocks, shape: tuple[int, int, int]
) -> jax.Array:
    """Σ_i f_i of points' masses [N] in the touched blocks.

    [M, 8, 8, 8] as (depth, row, col); 0 where the last block stands out of the volume.
    """
    counts, order = touched.divide(shape), splatting.ORDERS[scene.method]
    first = splatting.find_first(jax.lax.stop_gradient(scene.coordinates), shape, order)
    side = BLOCK + order
    slot = blocks.slots[touched.number(first // BLOCK, counts)]
    has_slot = slot < len(blocks.ids)
    cells: Any = splatting.scatter(
        scene.coordinates - first,
        jnp.where(scene.is_inside & has_slot, mass, 0),
        jnp.where(has_slot, slot, 0),
        first % BLOCK,
        order,
        # What a block's points give to the next one is kept in cells of its own.
        (len(blocks.ids), side, side, side),
    )
    sigma = splatting.narrow(jnp.asarray(scene.sigma), order)
    kernel = kernels.sample_gaussian(jnp.arange(BLOCK, dtype=cells.dtype), sigma)
    density = _smooth(cells, kernel, blocks, counts)
    if shape[2] % BLOCK == 0:
        return density
    depths = touched.find_depths(blocks.ids, shape)
    return jnp.where((depths < shape[2])[:, :, None, None], density, 0)


def _smooth(cells, kernel, blocks, counts):
    sides = cells.shape[-1], BLOCK
    for axis, axes in _PASSES:
        neighbours = touched.find_neighbours(blocks, counts, axis)
        smoothed: Any = _smooth_axis(cells, kernel, neighbours, sides)
        cells = jnp.transpose(smoothed, axes)
    return cells


@functools.partial(jax.custom_vjp, nondiff_argnums=(3,))
def _smooth_axis(cells, kernel, neighbours, sides):
    """Smooth along the last axis, of as many cells as the first of `sides` says.

    The result has as many as the second.

    Σ_j g_j·(v[i - j] + v[i + j]) as one product with a band matrix, from the cells of a
    block to those of the block before, its own and the one after.
    """
    return _take_shares(_multiply(cells, kernel, sides[1]), neighbours)


def _multiply(cells, kernel, side):
    """What each block gives to three: [M, A, B, 3·side]."""
    targets = BLOCK * jnp.array([[-1], [0], [1]]) + jnp.arange(side)[None]
    distance = jnp.abs(jnp.arange(cells.shape[-1])[:, None] - targets.reshape(1, -1))
    band = jnp.where(distance < BLOCK, kernel[distance.clip(0, BLOCK - 1)], 0)
    return jnp.matmul(cells, band, precision="highest")


def _take_shares(shares, neighbours):
    """Add up what each block gets, [M, A, B, side]."""
    from_before, own, from_after = jnp.split(shares, 3, axis=-1)[::-1]
    for found, slots in zip((from_before, from_after), neighbours, strict=True):
        own = own + _look_up(found, slots)
    return own


def _give_shares(cotangent, neighbours):
    """The transpose of `_take_shares`."""
    before, after = (_look_up(cotangent, slots) for slots in neighbours)
    return jnp.concatenate([before, cotangent, after], axis=-1)


def _look_up(cells, slots):
    """Blocks in the slots; empty ones for the slot M."""
    is_there = slots < len(cells)
    found = cells[jnp.where(is_there, slots, 0)]
    return jnp.where(is_there[:, None, None, None], found, 0)


def _smooth_axis_forward(cells, kernel, neighbours, sides):
    # The backward pass needs the cells only for the gradient of sigma.
    kept = cells.value if kernel.perturbed else None
    slots = tuple(slots.value for slots in neighbours)
    smoothed = _smooth_axis(cells.value, kernel.value, slots, sides)
    return smoothed, (kept, kernel.value, slots)


def _smooth_axis_backward(sides, residuals, cotangent):
    cells, kernel, neighbours = residuals
    if isinstance(cotangent, jax.custom_derivatives.SymbolicZero):
        cotangent = jnp.zeros(cotangent.shape, kernel.dtype)
    kernel_grad = None
    if cells is not None:
        _, pull_back = jax.vjp(lambda k: _multiply(cells, k, sides[1]), kernel)
        (kernel_grad,) = pull_back(_give_shares(cotangent, neighbours))
    back = _smooth_axis(cotangent, kernel, neighbours, sides[::-1])
    return back, kernel_grad, (None, None)


_smooth_axis.defvjp(_smooth_axis_forward, _smooth_axis_backward, symbolic_zeros=True)
