"""Where a category has which colours, and what those of a view say of its pose.

Not in the paper. Lamps are yellow in front and red behind: silhouettes from the front
and from behind may be one, and a truck turned round, its cab high in front, has that of
a car; colours are not the same. Those of visible points are counted in cells of the
network's frame. A view is likelier from a pose in which the points that are visible
from there have in it the colours that are usual in their cells.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.special import ndtr

from dpc_jax.learning.cameras import Cameras, place_camera
from dpc_jax.learning.candidates import turn_index
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.framing import Frame, find_place, frame_by_moments
from dpc_jax.render import Camera, VoxelGrid, quaternion
from dpc_jax.render.camera import to_camera_frame, to_grid

CELLS = 12  # along each axis of the object frame
BINS = 8  # along each of two axes of hue
POINTS = 1000  # of a shape, that are looked at
KEPT = 0.995  # of moving sums in a step: 200 batches
_IMAGE = 24  # side in which points hide each other
_BEHIND = 0.06  # box diagonals, within which points of a pixel are seen
# Variances of an image's edges in pixels², of renders in 19 of 20 at most; and beyond
# these the largest blur that is undone.
_SHARP, _BLURRED = 0.25, 1.5
_PAINT = 0.1  # share of a view from which on a colour counts less: it is its paint
# Times that a sample counts beside a pixel of silhouettes: these err by whole outlines.
_TRUST = 4.0
_PRIOR = 500.0  # samples of the category's mean colours in each cell


class Samples(NamedTuple):
    """Colours of an object as a view shows them; n samples.

    Attributes:
      places: [n, 3] in the network's frame.
      bins: [n] int32 of their colours, or [n, BINS²] shares of them.
      weights: [n], 0 of what is not seen.
    """

    places: jax.Array
    bins: jax.Array
    weights: jax.Array


def start_counts() -> jax.Array:
    """Of nothing yet: colours in cells [CELLS³, BINS²], moving sums over batches."""
    return jnp.zeros((CELLS**3, BINS**2))


def turn_views(
    winners: Winners,
    points: jax.Array,
    batch: Mapping[str, jax.Array],
    turns: jax.Array,
    counts: jax.Array,
    *,
    camera: Camera,
    cameras: Cameras,
    heads: int,
    is_due: jax.Array,
) -> tuple[Winners, jax.Array, jax.Array]:
    """The half turns of views that colours and silhouettes find likelier together.

    Args:
      winners: of n views, with their losses. points: [n, N, 3].
      batch: images uint8 [n, S, S, 3] and masks uint8 [n, S, S].
      turns: [T, 4] of objects. counts: of the batches before.
      camera, cameras: of the views. heads: K, of the candidates.
      is_due: () whether views are turned at this step, or counted alone.

    Returns:
      (the winners to learn, the counts with this batch, () share of views turned).
    """
    scores = jnp.where(is_due, score_colors(counts), 0)
    still = lax.stop_gradient((points[:, :POINTS], winners, cameras))

    def judge_view(points, winner, per_view, image, mask):
        poses = jax.vmap(quaternion.multiply, (None, 0))(winner.poses, turns)
        indices = turn_index(winner.indices, jnp.arange(len(turns)), heads)
        bins = sort_colors(image / 255)

        def see(pose):
            view = {"rotation": pose, **per_view}
            found = weigh_paint(see_points(points, view, bins, mask, camera=camera))
            return found, judge_samples(found, scores)

        samples, fits = jax.vmap(see)(poses)
        # Both as logarithms of likelihoods, as in `explanation.find_posteriors`.
        best = jnp.argmax(fits - winner.losses[indices])
        return best, jax.tree.map(lambda a: a[best], samples)

    chosen, samples = jax.vmap(judge_view)(*still, batch["images"], batch["masks"])
    places, bins, weights = (a.reshape(-1, *a.shape[2:]) for a in samples)
    seen = jnp.zeros_like(counts).at[find_cells(*places.T), bins].add(weights)
    counts = KEPT * counts + lax.psum(seen, AXIS)
    return winners.turn(turns, chosen, heads=heads), counts, jnp.mean(chosen > 0)


def see_points(
    points: jax.Array,
    per_view: Mapping[str, jax.Array],
    bins: jax.Array,
    mask: jax.Array,
    *,
    camera: Camera,
    frame: Frame | None = None,
) -> Samples:
    """Samples of points [N, 3] in a view: 1 is the weight of what is seen.

    Args:
      per_view: rotation of the view, and its `Cameras`.
      bins: [S, S, ...] of an image, by `sort_colors` or `spread_colors`.
      mask: uint8 [S, S].
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
    row, col = _find_pixels(places, len(mask))
    is_seen &= mask[row, col] >= 128
    return Samples(points, bins[row, col], is_seen.astype(points.dtype))


def _find_pixels(places, side):
    pixels = jnp.floor((places + 0.5) * side)
    return jnp.clip(pixels, 0, side - 1).astype(jnp.int32).T


def weigh_paint(samples: Samples) -> Samples:
    """The samples of a view; a colour weighs less the more of it there is."""
    bins, weights = samples.bins, samples.weights
    if bins.ndim == 1:
        amounts = jnp.zeros(BINS**2).at[bins].add(weights)
    else:
        amounts = weights @ bins
    shares = amounts / jnp.maximum(jnp.sum(amounts), 1)
    own = shares[bins] if bins.ndim == 1 else bins @ shares
    return samples._replace(weights=weights / (1 + (own / _PAINT) ** 2))


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
    cells, bins = find_cells(*samples.places.T), samples.bins
    if bins.ndim == 1:
        found = scores[cells, bins]
    else:
        found = jnp.log(jnp.sum(bins * jnp.exp(scores[cells]), axis=1))
    return _TRUST * jnp.sum(samples.weights * found)


def sort_colors(colors: jax.Array) -> jax.Array:
    """Bins [...] int32 of colours [..., 3] by their hue and saturation, not brightness.

    Two axes of `BINS` each.
    """
    axes, whole = _find_hues(colors)
    first, second = (
        jnp.clip(jnp.floor((0.5 + axis / whole / 2) * BINS), 0, BINS - 1)
        for axis in axes
    )
    return (first * BINS + second).astype(jnp.int32)


def spread_colors(image: jax.Array, mask: jax.Array) -> jax.Array:
    """Shares [S, S, BINS²] of the bins that colours had before blur and noise.

    Of a clean image the bins of `sort_colors`. Training counts those of clean images; a
    colour that blur or noise moves into a bin which is rare there would say much of the
    pose.

    Args:
      image: uint8 [S, S, 3]. mask: uint8 [S, S], within which both are measured.
    """
    # Away from the outline, which is as sharp as the mask if that cut the image out.
    is_inside = lax.reduce_window(
        *(mask >= 128, True, lax.bitwise_and), (5, 5), (1, 1), "SAME"
    )
    # Greys lie on the edge of two bins, and without noise are of the upper one.
    edges = jnp.linspace(-1, 1, BINS + 1)[None, None] - 1e-4
    edges = edges.at[..., 0].set(-jnp.inf).at[..., -1].set(jnp.inf)
    axes, whole = _find_hues(_sharpen(image / 255, is_inside))
    shares = []
    for axis in axes:
        widths = jnp.maximum(_measure_noise(axis, is_inside) / whole, 1e-6)[..., None]
        away = (edges - (axis / whole)[..., None]) / widths
        shares.append(jnp.diff(ndtr(away)))
    first, second = shares
    return (first[..., None] * second[..., None, :]).reshape(*mask.shape, BINS**2)


def _find_hues(colors):
    """Two differences of the channels [..., 3], and what they are divided by."""
    red, green, blue = jnp.moveaxis(colors, -1, 0)
    return (red - green, (red + green) / 2 - blue), jnp.max(colors, axis=-1) + 0.1


def _sharpen(image, is_inside):
    """An image [S, S, 3] without the blur that is measured inside, to first order.

    Squared differences of neighbours add up over edges of a width s in proportion to
    1/s: by how much a further blur by one pixel lowers them tells s.
    """
    places = jnp.arange(len(image))
    weights = jnp.exp(-((places[:, None] - places[None]) ** 2) / 2)
    weights /= jnp.sum(weights, axis=1, keepdims=True)
    soft = jnp.einsum("ij,jkc,lk->ilc", weights, image, weights)

    def measure(image):
        down, right = (jnp.diff(image, axis=axis) ** 2 for axis in range(2))
        steps = jnp.sum(down[:, 1:] + right[1:], axis=-1)
        return jnp.sum(jnp.where(is_inside[1:, 1:], steps, 0))

    # What has no edges at all counts as sharp.
    ratio = (measure(image) + 1e-3) / (measure(soft) + 1e-6)
    variance = 1 / jnp.maximum(ratio**2 - 1, 0.1)
    excess = jnp.clip(variance - _SHARP, 0, _BLURRED)
    return jnp.clip(image + excess * (image - soft), 0, 1)


def _measure_noise(values, is_inside):
    """Standard deviation of the noise of values [S, S] inside; 0 if nothing is.

    By the median size of what a difference of Laplacians leaves (Immerkær, 1996):
    evenly shaded faces leave nothing, and edges are few.
    """
    for _ in range(2):  # [1, -2, 1] along each of the axes
        values = (values[:-2] - 2 * values[1:-1] + values[2:]).T
    is_inside = is_inside[1:-1, 1:-1]
    sizes = jnp.sort(jnp.where(is_inside, jnp.abs(values), jnp.inf), axis=None)
    count = jnp.sum(is_inside)
    # The kernel's norm is 6; the median of a normal variable's size is 0.6745 of it.
    return jnp.where(count > 0, sizes[count // 2], 0) / (6 * 0.6745)


def find_cells(*place: jax.Array) -> jax.Array:
    """Cells int32 of places, whose three coordinates are arrays of one shape."""
    x, y, z = (jnp.clip(jnp.floor((a + 0.5) * CELLS), 0, CELLS - 1) for a in place)
    return ((x * CELLS + y) * CELLS + z).astype(jnp.int32)
