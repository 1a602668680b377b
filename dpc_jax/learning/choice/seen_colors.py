"""Which colours the views of an object show where on its predicted shape."""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import place_camera
from dpc_jax.render import Camera, VoxelGrid
from dpc_jax.render.camera import to_camera_frame, to_grid

BINS = 8  # along each of two axes of hue
_IMAGE = 24  # side in which points hide each other
_BEHIND = 0.06  # box diagonals, within which points of a pixel are seen
_PAINT = 0.1  # share of an object from which on a colour counts less: it is its paint


class Samples(NamedTuple):
    """Colours of an object as its views show them; n samples.

    Attributes:
      places: [n, 3] in the network's frame. bins: [n] int32 of their colours.
      weights: [n], 0 of what is not seen.
    """

    places: jax.Array
    bins: jax.Array
    weights: jax.Array


def see_object(
    points: jax.Array,
    per_view: Mapping[str, jax.Array],
    images: jax.Array,
    masks: jax.Array,
    *,
    camera: Camera,
) -> Samples:
    """Samples of all views of an object; a colour weighs less the more of it there is.

    Args:
      points: [N, 3]. per_view: of V views, their rotation and their `Cameras`.
      images: uint8 [V, S, S, 3]. masks: uint8 [V, S, S].
    """
    see = functools.partial(_see_view, camera=camera)
    bins, weights = jax.vmap(see, (None, 0, 0, 0))(points, per_view, images, masks)
    bins, weights = bins.reshape(-1), weights.reshape(-1)
    amounts = jnp.zeros(BINS**2).at[bins].add(weights)
    shares = amounts / jnp.maximum(jnp.sum(amounts), 1)
    weights = weights / (1 + (shares[bins] / _PAINT) ** 2)
    places = jnp.broadcast_to(points[None], (len(images), *points.shape))
    return Samples(places.reshape(-1, 3), bins, weights)


def _see_view(points, per_view, image, mask, *, camera):
    """Bins [N] of the colours of points in a view, and weights [N]: 0 if hidden."""
    camera, side = place_camera(camera, per_view), image.shape[0]
    moved = to_camera_frame(
        points,
        per_view["rotation"],
        translation=per_view.get("translation"),
        camera=camera,
    )
    seen = to_grid(moved, camera=camera, grid=VoxelGrid(_IMAGE))
    rows, cols, _ = seen.coordinates.T

    def find_pixel(side):
        scale = side / _IMAGE
        row, col = (jnp.floor((axis + 0.5) * scale) for axis in (rows, cols))
        return [jnp.clip(a, 0, side - 1).astype(jnp.int32) for a in (row, col)]

    row, col = find_pixel(_IMAGE)
    ahead = jnp.where(seen.inside, moved.ahead, jnp.inf)
    nearest = jnp.full((_IMAGE, _IMAGE), jnp.inf).at[row, col].min(ahead)
    row_, col_ = find_pixel(side)
    is_seen = seen.inside & (ahead < nearest[row, col] + _BEHIND)
    is_seen &= mask[row_, col_] >= 128
    return sort_colors(image[row_, col_] / 255), is_seen.astype(points.dtype)


def sort_colors(colors: jax.Array) -> jax.Array:
    """Bins [n] int32 of colours [n, 3] by their hue and saturation, not brightness."""
    red, green, blue = colors.T
    whole = jnp.max(colors, axis=1) + 0.1
    axes = (red - green) / whole, ((red + green) / 2 - blue) / whole
    first, second = (
        jnp.clip(jnp.floor((0.5 + axis / 2) * BINS), 0, BINS - 1) for axis in axes
    )
    return (first * BINS + second).astype(jnp.int32)
