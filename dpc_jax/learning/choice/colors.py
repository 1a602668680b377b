"""Where a category has which colours, and what those of a view say of its pose.

Not in the paper. Lamps are yellow in front and red behind: silhouettes from the front
and from behind may be one, colours are not. The colours of visible points are counted
in cells of the network's frame; a view is likelier from a pose in which the points that
are visible from there have in it the colours that are usual in their cells.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.framing import Frame, find_place, frame_by_moments
from dpc_jax.render import Camera, VoxelGrid, quaternion
from dpc_jax.render.camera import to_camera_frame, to_grid

CELLS = 12  # along each axis of the object frame
BINS = 8  # along each of two axes of hue
POINTS = 1000  # of a shape, that are looked at
_IMAGE = 24  # side in which points hide each other
_BEHIND = 0.06  # box diagonals, within which points of a pixel are seen
_PAINT = 0.1  # share of a view from which on a colour counts less: it is its paint
# Times that a sample counts beside a pixel of silhouettes: these err by whole outlines.
_TRUST = 4.0
_PRIOR = 500.0  # samples of the category's mean colours in each cell


class Samples(NamedTuple):
    """Colours of an object as a view shows them; n samples.

    Attributes:
      places: [n, 3] in the network's frame. bins: [n] int32 of their colours.
      weights: [n], 0 of what is not seen.
    """

    places: jax.Array
    bins: jax.Array
    weights: jax.Array


def see_points(
    points: jax.Array,
    per_view: Mapping[str, jax.Array],
    image: jax.Array,
    mask: jax.Array,
    *,
    camera: Camera,
    frame: Frame | None = None,
) -> Samples:
    """Samples of points [N, 3] in a view: 1 is the weight of what is seen.

    Args:
      per_view: rotation of the view, and its `Cameras`.
      image: uint8 [S, S, 3]. mask: uint8 [S, S].
      frame: of the mask, by its moments, where the view's distance is not known: the
        image of the points is moved and scaled into it.
    """
    camera, shift = place_camera(camera, per_view), per_view.get("translation")
    moved = to_camera_frame(points, per_view["rotation"], shift)
    found, is_inside = to_grid(moved, camera=camera, grid=VoxelGrid(_IMAGE))
    places = (found[:, :2] + 0.5) / _IMAGE - 0.5  # row before column
    row, col = _find_pixels(places, _IMAGE)
    ahead = jnp.where(is_inside, camera.find_depths(moved), jnp.inf)
    nearest = jnp.full((_IMAGE, _IMAGE), jnp.inf).at[row, col].min(ahead)
    is_seen = is_inside & (ahead < nearest[row, col] + _BEHIND)
    if frame is not None:
        shown = jnp.isfinite(nearest).astype(points.dtype)
        place = find_place(frame, frame_by_moments(shown))
        places = place.centre[None] + place.side * places
    row, col = _find_pixels(places, len(image))
    is_seen &= mask[row, col] >= 128
    bins = sort_colors(image[row, col] / 255)
    return Samples(points, bins, is_seen.astype(points.dtype))


def _find_pixels(places, side):
    pixels = jnp.floor((places + 0.5) * side)
    return jnp.clip(pixels, 0, side - 1).astype(jnp.int32).T


def weigh_paint(samples: Samples) -> Samples:
    """The samples of a view; a colour weighs less the more of it there is."""
    bins, weights = samples.bins, samples.weights
    amounts = jnp.zeros(BINS**2).at[bins].add(weights)
    shares = amounts / jnp.maximum(jnp.sum(amounts), 1)
    return samples._replace(weights=weights / (1 + (shares[bins] / _PAINT) ** 2))


def score_colors(counts: jax.Array) -> jax.Array:
    """Log-likelihood of colours in cells [CELLS³, BINS²] by their weights there.

    Relative to the category's colours anywhere, nats.
    """
    usual = (jnp.sum(counts, axis=0) + 1e-3) / (jnp.sum(counts) + 1e-3 * BINS**2)
    there = (counts + _PRIOR * usual[None]) / (
        jnp.sum(counts, axis=1, keepdims=True) + _PRIOR
    )
    return jnp.log(there / usual[None])


def judge_samples(samples: Samples, scores: jax.Array) -> jax.Array:
    """How well samples fit `score_colors`: () a log-likelihood beside silhouettes'."""
    found = scores[find_cells(*samples.places.T), samples.bins]
    return _TRUST * jnp.sum(samples.weights * found)


def compare_turns(samples: Samples, turns: jax.Array, scores: jax.Array) -> jax.Array:
    """Means [T] of `judge_samples` after each of the turns [T, 4] of the object."""

    def fit(turn):
        places = quaternion.rotate(samples.places, turn)
        return judge_samples(samples._replace(places=places), scores)

    count = jnp.sum(samples.weights > 0)
    return jax.vmap(fit)(turns) / jnp.maximum(count, 1)


def sort_colors(colors: jax.Array) -> jax.Array:
    """Bins [n] int32 of colours [n, 3] by their hue and saturation, not brightness."""
    red, green, blue = colors.T
    whole = jnp.max(colors, axis=1) + 0.1
    axes = (red - green) / whole, ((red + green) / 2 - blue) / whole
    first, second = (
        jnp.clip(jnp.floor((0.5 + axis / 2) * BINS), 0, BINS - 1) for axis in axes
    )
    return (first * BINS + second).astype(jnp.int32)


def find_cells(*place: jax.Array) -> jax.Array:
    """Cells int32 of places, whose three coordinates are arrays of one shape."""
    x, y, z = (jnp.clip(jnp.floor((a + 0.5) * CELLS), 0, CELLS - 1) for a in place)
    return ((x * CELLS + y) * CELLS + z).astype(jnp.int32)
