"""One frame for a category: kinds that are learned in reverse are turned back.

Not in the paper. Shape and pose of an object agree with each other as well after a half
turn of both. Where a kind of objects looked more like the others that way in the first
steps, all of it is learned so, and no silhouette refutes it. What does is the category:
where its points are (a chair whose seat and back are exchanged), or where it has which
colours (lamps are yellow in front and red behind; a truck turned round, its cab high in
front, has the silhouette of a car, but not its lamps).

Points and colours are counted in cells of the network's frame: of the last objects the
points, by moving sums over batches the colours. Of each object, with all its views and
the shapes that are predicted from them, it is asked whether it fits these better after
a half turn. If so, its views learn the turned poses, and with them its shape learns to
turn, without colours until it fits (`decisions`). Where colours are asked for they
decide, as soon as they tell the category from its half turn; until then points do. From
then on they decide between the half turns of single views, too, together with
silhouettes: these hardly tell a car seen from the front from one seen from behind.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.candidates import find_half_turns
from dpc_jax.learning.choice import colors
from dpc_jax.learning.choice.colors import BINS, CELLS, POINTS, find_cells
from dpc_jax.learning.choice.decisions import Decisions, keep_turns, start_decisions
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.render import Camera, quaternion

OBJECTS = 256  # the last ones, whose points are remembered
_ALIKE = 0.2  # share of these objects, the most like one, that do not judge it
_EMPTY = 0.02  # density that is added, of the mean over the cells
_BLUR = (0.12, 0.76, 0.12)  # of densities, along each axis
_SHIFTS = tuple(0.04 * i for i in range(-5, 6))  # along each axis, box diagonals
_SCALES = (0.8, 1.0, 1.25)
_FITTED = 100  # points of a shape, that are moved and scaled to fit
_KEPT = 0.995  # of the sums in a step: 200 batches
# Standard deviations below 0 of what a half turn gains by points or colours, to count.
# A kind that is turned round makes two peaks of it, which is wide then.
_CLARITY = 0.5
# Shares of the usual loss by a half turn: that points have to gain by one, and that
# objects lose which fit as they are.
_MARGIN, _FITTING = 0.3, 0.5


class Frame(NamedTuple):
    """What is where in the category.

    Attributes:
      shapes: [OBJECTS, CELLS³] of each of the last objects the share of its points in
        each cell, blurred; zeros where there was none yet.
      count: () int32 of all objects so far.
      colors: [CELLS³, BINS²] of colours, a moving sum over batches; None
        where they are not asked for.
      moments: [3, 1 or 2, T - 1] moving sums of 1, x and x², where x is what objects
        gain by points, and by colours, after each half turn, per point or sample.
      decisions: half turns that shapes may not have followed yet; None with colours,
        by which half turns are better not kept (docs/log.md).
    """

    shapes: jax.Array
    count: jax.Array
    colors: jax.Array | None
    moments: jax.Array
    decisions: Decisions | None


def start_frame(turns: int = 4, *, by_colors: bool) -> Frame:
    """Of nothing yet; T turns of objects, none among them."""
    return Frame(
        jnp.zeros((OBJECTS, CELLS**3)),
        jnp.zeros((), jnp.int32),
        jnp.zeros((CELLS**3, BINS**2)) if by_colors else None,
        jnp.zeros((3, 2 if by_colors else 1, turns - 1)),
        None if by_colors else start_decisions(),
    )


def turn_back(
    winners: Winners,
    points: jax.Array,
    batch: Mapping[str, jax.Array],
    covariance: jax.Array,
    frame: Frame,
    *,
    camera: Camera,
    cameras: Cameras,
    views: int,
    heads: int,
    is_due: jax.Array,
) -> tuple[Winners, Frame, jax.Array]:
    """Half turns of the objects that fit the category better that way.

    Args:
      winners: of B·V views, those of an object side by side; with their losses where
        the frame has colours.
      points: [B·V, N, 3], for each view of its object.
      batch: images uint8 [B·V, S, S, 3], masks uint8 [B·V, S, S], and view_ids int32
        [B·V], by which views are known again.
      covariance: [3, 3] of points, whose axes the half turns are about.
      frame: of the batches before. camera, cameras: of the views.
      views: V. heads: K, of the candidates.
      is_due: () whether objects are turned at this step, or counted alone.

    Returns:
      (the winners to learn, the frame with this batch, () share of objects turned).
    """
    points, covariance = jax.lax.stop_gradient((points[:, :POINTS], covariance))
    turns, samples = find_half_turns(covariance, frame.moments.shape[2] + 1), None
    if frame.colors is not None:
        scores = jnp.where(is_due, score_clear_colors(frame), 0)
        seen = *jax.lax.stop_gradient((winners, dict(cameras))), batch
        chosen, samples = _judge_views(points, *seen, turns, scores, camera, heads)
        winners = _turn_winners(winners, turns, chosen, heads)
    gains = _measure_gains(points, samples, turns, covariance, frame)
    gains = jnp.mean(gains.reshape(len(gains), -1, views, len(turns) - 1), axis=2)
    wanted, fits = _choose_turns(gains, frame.moments)
    wanted = jnp.where(is_due, wanted, 0)
    turned, decisions = jnp.repeat(wanted, views), None
    if frame.decisions is not None:
        found = wanted, fits, winners.poses, turns, batch["view_ids"]
        turned, decisions = keep_turns(frame.decisions, *found)
    winners = _turn_winners(winners, turns, turned, heads)
    if samples is not None:
        places = jax.vmap(quaternion.rotate)(samples.places, turns[turned])
        samples = samples._replace(places=places)
    # Shapes are counted as they are predicted: turned ones would vote for more of them.
    new = _count_batch(frame, points[::views], samples, gains)
    is_turned = jnp.any(turned.reshape(-1, views) > 0, axis=1)
    return winners, new._replace(decisions=decisions), jnp.mean(is_turned)


def _turn_winners(winners, turns, chosen, heads):
    """The winners [n] after the chosen [n] of the turns [T, 4]."""
    poses = jax.vmap(quaternion.multiply)(winners.poses, turns[chosen])
    return Winners(poses, _turn_index(winners.indices, chosen, heads))


def _turn_index(index, turn, heads):
    """The candidate of the same head after one more half turn.

    Candidate i is of head i % K after half turn i // K, and these form a group in which
    the turn a after the turn b is the turn a ^ b.
    """
    return (index // heads ^ turn.astype(jnp.int32)) * heads + index % heads


def score_clear_colors(frame: Frame) -> jax.Array:
    """`colors.score_colors` of the category; 0 where they tell nothing of turns."""
    assert frame.colors is not None
    _, is_clear = _find_clarity(frame.moments)
    return jnp.where(jnp.any(is_clear[1]), colors.score_colors(frame.colors), 0)


def _judge_views(points, winners, cameras, batch, turns, scores, camera, heads):
    """Half turns of single views that colours and silhouettes find likelier together.

    Returns:
      ([n] of the turns, `Samples` of each view after them).
    """

    def judge_view(points, winner, per_view, image, mask):
        poses = jax.vmap(quaternion.multiply, (None, 0))(winner.poses, turns)
        indices = _turn_index(winner.indices, jnp.arange(len(turns)), heads)
        bins = colors.sort_colors(image / 255)

        def see(pose):
            view = {"rotation": pose, **per_view}
            found = colors.see_points(points, view, bins, mask, camera=camera)
            found = colors.weigh_paint(found)
            return found, colors.judge_samples(found, scores)

        samples, fits = jax.vmap(see)(poses)
        # Both as logarithms of likelihoods, as in `explanation.find_posteriors`.
        best = jnp.argmax(fits - winner.losses[indices])
        return best, jax.tree.map(lambda a: a[best], samples)

    views = winners, cameras, batch["images"], batch["masks"]
    return jax.vmap(judge_view)(points, *views)


def _measure_gains(points, samples, turns, covariance, frame):
    """What views gain by points, and by colours, after half turns; [., n, T - 1]."""
    ways = list_ways(covariance, is_upright=len(turns) == 2)

    def compare(points):
        scores = judge_cells(points, frame.shapes, frame.count)
        return compare_places(points[:_FITTED], turns, ways, scores)

    fits = [jax.vmap(compare)(points)]
    if samples is not None:
        scores = colors.score_colors(frame.colors)
        fits += [jax.vmap(lambda x: colors.compare_turns(x, turns, scores))(samples)]
    return jnp.stack([a[:, 1:] - a[:, :1] for a in fits])


def _choose_turns(gains, moments):
    """Which half turn [B] objects want, 0 for none; whether [B] they fit by points.

    Only what tells a category from its own half turn counts: objects that look the same
    either way would be turned by chance.
    """
    mean, is_clear = _find_clarity(moments)
    # What fits both ways alike is left to its views, or to what was decided before.
    total = jnp.where(is_clear[0], gains[0] + _MARGIN * mean[:1], -jnp.inf)
    fits = ~is_clear[:1] | (gains[0] < _FITTING * mean[:1])
    if len(gains) > 1:
        total = jnp.where(is_clear[1], gains[1], total)
    wanted = jnp.where(jnp.max(total, axis=1) > 0, jnp.argmax(total, axis=1) + 1, 0)
    return wanted, jnp.all(fits, axis=1)


def _find_clarity(moments):
    """Mean gains by a half turn, and whether they tell the category from it."""
    mean, square = moments[1:] / jnp.maximum(moments[:1], 1e-6)
    spread = jnp.sqrt(jnp.maximum(square - mean**2, 0))
    return mean, mean < -_CLARITY * spread


def _count_batch(frame, points, samples, gains):
    """The frame after a batch, of all devices."""
    shapes = jax.lax.all_gather(jax.vmap(count_points)(points), AXIS, tiled=True)
    # Of a batch that is larger than what is remembered, its last objects.
    rows = (frame.count + jnp.arange(len(shapes))[-OBJECTS:]) % OBJECTS
    moments = jnp.stack([jnp.mean(gains**power, axis=1) for power in range(3)])
    moments = jax.lax.pmean(moments, AXIS)
    new = frame._replace(
        shapes=frame.shapes.at[rows].set(shapes[-OBJECTS:]),
        count=frame.count + len(shapes),
    )
    if samples is not None:
        places, bins, weights = (a.reshape(-1, *a.shape[2:]) for a in samples)
        kept, nothing = _KEPT * frame.colors, jnp.zeros_like(frame.colors)
        seen = nothing.at[find_cells(*places.T), bins].add(weights)
        new = new._replace(colors=kept + jax.lax.psum(seen, AXIS))
    return new._replace(moments=_KEPT * frame.moments + moments)


def count_points(points: jax.Array) -> jax.Array:
    """Share of points [N, 3] in each cell, blurred; [CELLS³]."""
    density = jnp.zeros(CELLS**3).at[find_cells(*points.T)].add(1 / len(points))
    density = density.reshape((CELLS,) * 3)
    for axis in range(3):  # the cells at the border, which roll over, are empty
        rolled = [jnp.roll(density, shift, axis) for shift in (-1, 0, 1)]
        density = jnp.tensordot(jnp.array(_BLUR), jnp.stack(rolled), 1)
    return density.reshape(-1)


def judge_cells(points: jax.Array, shapes: jax.Array, count: jax.Array) -> jax.Array:
    """Log-likelihood [CELLS³] of a point in each cell, by the objects unlike one.

    Relative to points that are anywhere. The fifth of all objects that are most like
    the points [N, 3] does not count: where a whole kind is turned round, it agrees.

    Args:
      shapes: [OBJECTS, CELLS³] of `count_points`, zeros where there was none yet.
      count: () int32 of all objects so far.
    """
    # Squared distances, but for what all have: its square is the same.
    away = jnp.sum(shapes**2, axis=1) - 2 * (shapes @ count_points(points))
    away = jnp.where(jnp.arange(OBJECTS) < count, away, jnp.inf)
    known = jnp.minimum(count, OBJECTS)
    nearest = jnp.sort(away)[(_ALIKE * known).astype(jnp.int32)]
    density = (away >= nearest).astype(points.dtype) @ shapes
    mean = jnp.maximum(jnp.mean(density), jnp.finfo(points.dtype).tiny)
    return jnp.log(density / mean + _EMPTY)


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
    points: jax.Array, turns: jax.Array, ways: jax.Array, scores: jax.Array
) -> jax.Array:
    """Mean log-likelihood [T] of points [N, 3] after each of the turns [T, 4].

    By the scores [CELLS³] of `judge_cells`, nats per point, at the shift along one of
    the ways [A, 3] and at the scale that fit best. As they are, airplanes whose wings
    are farther in front than those of others fit better turned round: their wings are
    then where these have theirs, and only their tails are not.
    """
    shifts = (jnp.array(_SHIFTS)[:, None, None] * ways[None]).reshape(-1, 3)
    scales = jnp.array(_SCALES)[:, None, None]

    def fit(turn):
        turned = quaternion.rotate(points, turn)
        # Coordinate by coordinate, [scales, shifts, N]: three times as quick on a CPU.
        places = [
            scales * x[None, None] + by[None, :, None]
            for x, by in zip(turned.T, shifts.T, strict=True)
        ]
        is_inside = jnp.all(jnp.stack([jnp.abs(x) < 0.5 for x in places]), axis=0)
        found = jnp.where(is_inside, scores[find_cells(*places)], jnp.log(_EMPTY))
        return jnp.max(jnp.mean(found, axis=-1))

    return jax.vmap(fit)(turns)
