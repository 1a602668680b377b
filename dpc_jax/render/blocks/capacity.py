"""How many blocks there is room for, and where blocks are worth it."""

import functools
import math
from collections.abc import Callable
from typing import Any

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import checks
from dpc_jax.render.blocks import touched
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.fast import splatting
from dpc_jax.render.volume import Scene, place_points

# Blocks are counted unasked in grids of at least so many cells, and taken where they
# are at most this share of all. A cell of a block takes three times as long as one of
# the whole volume, and at 64³ the whole volume is as quick (two CPU cores).
_COUNTED_FROM = 128**3
_COUNTED_UP_TO = 4096**3  # the numbers of its blocks take half a gigabyte
_MOST_SHARE = 1 / 4
# Up to so many cells the whole volume steps in where blocks do not do: a third of a
# gigabyte for a gradient.
SMALL_UP_TO = 256**3


def count_blocks(
    points: jax.Array,
    rotation: jax.Array,
    *,
    sigma: chex.Numeric,
    translation: jax.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    method: str = "trilinear",
) -> jax.Array:
    """How many blocks of 8³ cells a cloud and its smoothing touch, () int32.

    For `max_blocks` take the largest count of several poses and a fifth to spare:

        counts = jax.vmap(lambda q: dpc_jax.count_blocks(points, q, sigma=0.6))(poses)
        max_blocks = int(1.2 * counts.max())

    Arguments and errors as of `project`.

    Returns:
      () int32; all blocks of the grid where blocks cannot draw what is asked, because
      the smoothing reaches beyond the next one.

    Example:
      >>> int(dpc_jax.count_blocks(jnp.zeros((1, 3)), jnp.eye(3), sigma=0.6))
      8
    """
    scene = place_points(
        *(points, rotation, sigma, 1.0, None, translation, camera, grid, method)
    )
    _check_method(scene.method)
    _check_grid(grid.shape)
    return _count(scene, shape=grid.shape)


@functools.partial(jax.jit, static_argnames="shape")
def _count(scene, *, shape):
    return touched.find_blocks(scene, shape, math.prod(touched.divide(shape))).count


def choose_room(
    scene: Scene, shape: tuple[int, int, int], max_blocks: int | None
) -> int | None:
    """Room for blocks to render a scene with, static; None for the whole volume."""
    if max_blocks is not None:
        checks.check_count("max_blocks", max_blocks, least=1)
        _check_method(scene.method)
    if scene.method not in splatting.ORDERS or min(shape) < touched.BLOCK:
        return None
    if max_blocks is not None:
        _check_grid(shape)
    else:
        numbers = scene.coordinates, scene.mass, scene.sigma
        max_blocks = count_room(lambda: _count(scene, shape=shape), shape, numbers)
    if max_blocks is None or max_blocks >= math.prod(touched.divide(shape)):
        return None
    sides = (max_blocks, *[touched.BLOCK] * 3)
    checks.check_room("max_blocks", sides, scene.coordinates.dtype)
    return max_blocks


def count_room(
    count: Callable[[], jax.Array], shape: tuple[int, int, int], numbers: Any
) -> int | None:
    """Room for as many blocks as `count` finds, unasked.

    None where some of the numbers are not known, or where blocks would not be quicker.
    """
    is_counted = _COUNTED_FROM <= math.prod(shape) <= _COUNTED_UP_TO
    if not (is_counted and checks.is_known(numbers)):
        return None
    found = int(count())
    if found > _MOST_SHARE * math.prod(touched.divide(shape)):
        return None
    # Up to a quarter of an octave, so that few programs are compiled.
    steps = math.ceil(4 * math.log2(max(found, 1)) - 1e-9)
    return max(found, math.ceil(2 ** (steps / 4)))


def _check_grid(shape):
    """Refuse a grid whose blocks cannot be numbered."""
    checks.check_room("grid", touched.divide(shape), jnp.int32)


def _check_method(method):
    hint = "blocks have one sigma for all points; leave max_blocks out otherwise"
    checks.check_choice("method", method, tuple(splatting.ORDERS), hint)
