"""One frame for a category: kinds that live turned round are taught to turn back.

Not in the paper. Shape and pose of an object agree with each other as well after a half
turn of both. Where a kind of objects looked more like the others that way in the first
steps, all of it is learned so, and no silhouette refutes it. What does is the category:
where its points are (a chair whose seat and back are exchanged), and where it has which
colours (lamps are yellow in front and red behind; a pickup turned round has the
silhouette of a sedan, but not its lamps).

Points and colours are counted in cells of the network's frame by moving sums over
batches. Of each object, with all its views, it is asked whether it fits these better
after a half turn. If so, its views learn the turned poses, and with them its shape
learns to turn.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras, list_own
from dpc_jax.learning.choice.batch_choice import Winners
from dpc_jax.learning.choice.seen_colors import BINS, Samples, see_object
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.half_turns import find_half_turns
from dpc_jax.render import Camera, quaternion

CELLS = 12  # along each axis of the object frame
_POINTS = 1000  # of a shape, that are looked at
_PRIOR = 500.0  # samples of the category's mean colours in each cell
_EMPTY = 0.02  # density that is added, of the mean over the cells
_FITTED = 400  # of these points, that are moved and scaled to fit
_SHIFTS = tuple(0.04 * i for i in range(-5, 6))  # along each axis, box diagonals
_SCALES = (0.8, 1.0, 1.25)
_BLUR = (0.12, 0.76, 0.12)  # of densities, along each axis
_KEPT = 0.995  # of the sums in a step: 200 batches
_CLARITY = 1.0  # standard deviations below 0 of what a half turn gains, to count
_COLOR_WEIGHT = 10.0  # of a nat per sample of colours, beside one per point


class Frame(NamedTuple):
    """What is where in the category, as moving sums over batches.

    Attributes:
      points: [CELLS, CELLS, CELLS] of points. colors: [CELLS³, BINS, BINS] of colours.
      moments: [3, 2, T - 1], of 1, x and x², where x is what objects gain by points and
        by colours after each half turn; nats per point or sample.
    """

    points: jax.Array
    colors: jax.Array
    moments: jax.Array


def start_frame(turns: int = 4) -> Frame:
    """Of nothing yet; T turns of objects, none among them."""
    return Frame(
        jnp.zeros((CELLS,) * 3),
        jnp.zeros((CELLS**3, BINS, BINS)),
        jnp.zeros((3, 2, turns - 1)),
    )


def turn_back(
    winners: Winners,
    points: jax.Array,
    images: jax.Array,
    masks: jax.Array,
    covariance: jax.Array,
    frame: Frame,
    *,
    camera: Camera,
    cameras: Cameras,
    heads: int,
    is_due: jax.Array,
) -> tuple[Winners, Frame, jax.Array]:
    """Half turns of the objects that fit the category better that way.

    Args:
      winners: of B objects with V views. points: [B, N, 3].
      images: uint8 [B, V, S, S, 3]. masks: uint8 [B, V, S, S].
      covariance: [3, 3] of points, whose axes the half turns are about.
      frame: of the batches before.
      camera, cameras: of the views. heads: K, of the candidates.
      is_due: () whether objects are turned at this step, or counted alone.

    Returns:
      (the winners to learn, the frame with this batch, () share of objects turned).
    """
    points, covariance = jax.lax.stop_gradient((points[:, :_POINTS], covariance))
    samples = _see_batch(points, winners, images, masks, cameras, camera)
    turns = find_half_turns(covariance, frame.moments.shape[2] + 1)
    ways = list_ways(covariance, is_upright=len(turns) == 2)
    gains = _measure_gains(points, samples, turns, ways, frame)
    turned = jnp.where(is_due, _choose_turns(gains, frame.moments), 0)

    # Candidate i is of head i % K after half turn i // K, and these form a group in
    # which the turn a after the turn b is the turn a ^ b.
    head, turn = winners.indices % heads, winners.indices // heads
    indices = (turn ^ turned[:, None].astype(jnp.int32)) * heads + head
    over_views = jax.vmap(quaternion.multiply, in_axes=(0, None))
    poses = jax.vmap(over_views)(winners.poses, turns[turned])
    turn_places = jax.vmap(quaternion.rotate)
    samples = samples._replace(places=turn_places(samples.places, turns[turned]))
    points = turn_places(points, turns[turned])
    new = _count_batch(frame, points, samples, gains)
    return Winners(poses, indices), new, jnp.mean(turned > 0)


def _see_batch(points, winners, images, masks, cameras, camera):
    """`see_object` of each object, from the poses of its views."""
    size, views = winners.indices.shape
    poses = jax.lax.stop_gradient(winners.poses)
    own = {"rotation": poses.reshape(-1, 4), **list_own(cameras, size * views)}
    own = {name: a.reshape(size, views, *a.shape[1:]) for name, a in own.items()}
    look = functools.partial(see_object, camera=camera)
    return jax.vmap(look)(points, own, images, masks)


def _measure_gains(points, samples, turns, ways, frame):
    """What objects gain by points and by colours after half turns; [2, B, T - 1]."""
    points = points[:, :_FITTED]
    by_points = jax.vmap(lambda x: compare_places(x, turns, ways, frame))(points)
    by_colors = jax.vmap(lambda x: compare_colors(x, turns, frame))(samples)
    return jnp.stack([a[:, 1:] - a[:, :1] for a in (by_points, by_colors)])


def _choose_turns(gains, moments):
    """Which half turn [B] each object is given; 0 for none.

    Only what tells a category from its own half turn counts: objects that look the same
    either way would be turned by chance.
    """
    mean, square = moments[1:] / jnp.maximum(moments[:1], 1e-6)
    spread = jnp.sqrt(jnp.maximum(square - mean**2, 0))
    is_clear = mean < -_CLARITY * spread
    weights = jnp.array([[1], [_COLOR_WEIGHT]]) * is_clear
    total = jnp.sum(weights[:, None] * gains, axis=0)
    # A kind that is turned round as a whole has its own colours where it has them, and
    # these say that it is right.
    total = jnp.where(is_clear[0], jnp.maximum(total, gains[0]), total)
    total = jnp.where(jnp.any(is_clear, axis=0), total, -jnp.inf)
    return jnp.where(jnp.max(total, axis=1) > 0, jnp.argmax(total, axis=1) + 1, 0)


def _count_batch(frame, points, samples, gains):
    """The frame after a batch, of all devices."""
    places = find_cells(points.reshape(-1, 3))
    counts = jnp.zeros(CELLS**3).at[places].add(1.0)
    cells = find_cells(samples.places.reshape(-1, 3))
    colors = jnp.zeros((CELLS**3, BINS**2))
    colors = colors.at[cells, samples.bins.reshape(-1)].add(samples.weights.reshape(-1))
    counts, colors = jax.lax.psum((counts, colors), AXIS)
    moments = jnp.stack([jnp.mean(gains**power, axis=1) for power in range(3)])
    moments = jax.lax.pmean(moments, AXIS)
    return Frame(
        _KEPT * frame.points + counts.reshape(frame.points.shape),
        _KEPT * frame.colors + colors.reshape(frame.colors.shape),
        _KEPT * frame.moments + moments,
    )


def list_ways(covariance: jax.Array, *, is_upright: bool) -> jax.Array:
    """Ways [A, 3] in which objects are moved to fit: the principal axes.

    Args:
      covariance: [3, 3] of points.
      is_upright: whether half turns are about z alone; the ways are level then.
    """
    if is_upright:
        _, axes = jnp.linalg.eigh(covariance[:2, :2])
        return jnp.pad(axes.T, ((0, 0), (0, 1)))
    return jnp.linalg.eigh(covariance)[1].T


def compare_places(
    points: jax.Array, turns: jax.Array, ways: jax.Array, frame: Frame
) -> jax.Array:
    """Mean log-likelihood [T] of points [N, 3] after each of the turns [T, 4].

    Relative to points that are anywhere, nats per point, at the shift along one of the
    ways [A, 3] and at the scale that fit best. For a kind whose wings are
    farther in front than those of other airplanes has them where these have theirs
    once it is turned round, and what is wrong then is the tail alone.
    """
    density = frame.points
    for axis in range(3):  # the cells at the border, which roll over, are empty
        rolled = [jnp.roll(density, shift, axis) for shift in (-1, 0, 1)]
        density = jnp.tensordot(jnp.array(_BLUR), jnp.stack(rolled), 1)
    mean = jnp.maximum(jnp.mean(density), jnp.finfo(points.dtype).tiny)
    scores = jnp.log(density.reshape(-1) / mean + _EMPTY)
    shifts = (jnp.array(_SHIFTS)[:, None, None] * ways[None]).reshape(1, -1, 1, 3)

    def fit(turn):
        turned = quaternion.rotate(points, turn)
        scaled = jnp.array(_SCALES)[:, None, None, None] * turned[None, None]
        places = scaled + shifts
        is_inside = jnp.all(jnp.abs(places) < 0.5, axis=-1)
        found = scores[find_cells(places.reshape(-1, 3))].reshape(is_inside.shape)
        return jnp.max(jnp.mean(jnp.where(is_inside, found, jnp.log(_EMPTY)), axis=-1))

    return jax.vmap(fit)(turns)


def compare_colors(samples: Samples, turns: jax.Array, frame: Frame) -> jax.Array:
    """Mean log-likelihood [T] of colours after each of the turns [T, 4] of the object.

    Relative to the category's colours anywhere, nats per sample.
    """
    counts = frame.colors.reshape(CELLS**3, BINS**2)
    usual = (jnp.sum(counts, axis=0) + 1e-3) / (jnp.sum(counts) + 1e-3 * BINS**2)
    there = (counts + _PRIOR * usual[None]) / (
        jnp.sum(counts, axis=1, keepdims=True) + _PRIOR
    )
    scores = jnp.log(there / usual[None])

    def fit(turn):
        cells = find_cells(quaternion.rotate(samples.places, turn))
        return jnp.sum(samples.weights * scores[cells, samples.bins])

    count = jnp.sum(samples.weights > 0)
    return jax.vmap(fit)(turns) / jnp.maximum(count, 1)


def find_cells(places: jax.Array) -> jax.Array:
    """Cells [n] int32 of places [n, 3]."""
    x, y, z = jnp.clip(jnp.floor((places + 0.5) * CELLS), 0, CELLS - 1).T
    return ((x * CELLS + y) * CELLS + z).astype(jnp.int32)
