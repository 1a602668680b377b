"""One frame for a category: kinds that are learned in reverse are turned back.

Not in the paper. Shape and pose of an object agree with each other as well after a half
turn of both. Where a kind of objects looked more like the others that way in the first
steps, all of it is learned so, and no silhouette refutes it. What does is where the
category's points are (a chair whose seat and back are exchanged).

The points of the last objects are counted in cells of the network's frame. Of each
object, with the shapes that are predicted from all its views, it is asked whether it
fits these better after a half turn. If so, its views learn the turned poses, and with
them its shape learns to turn (`decisions`). What colours say is in `colors`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.choice.colors import CELLS, KEPT, POINTS, find_cells
from dpc_jax.learning.choice.decisions import Decisions, keep_turns, start_decisions
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.render import quaternion

OBJECTS = 256  # the last ones, whose points are remembered
_ALIKE = 0.2  # share of these objects, the most like one, that do not judge it
_EMPTY = 0.02  # density that is added, of the mean over the cells
_BLUR = (0.12, 0.76, 0.12)  # of densities, along each axis
_SHIFTS = tuple(0.04 * i for i in range(-5, 6))  # along each axis, box diagonals
_SCALES = (0.8, 1.0, 1.25)
_FITTED = 100  # points of a shape, that are moved and scaled to fit
# Standard deviations below 0 of what a half turn gains, to count. A kind that is turned
# round makes two peaks of it, which is wide then.
_CLARITY = 0.5
# Shares of the usual loss by a half turn: that objects have to gain by one, and that
# those lose which fit as they are.
_MARGIN, _FITTING = 0.3, 0.5


class Frame(NamedTuple):
    """Where the category's points are.

    Attributes:
      shapes: [OBJECTS, CELLS³] of each of the last objects the share of its points in
        each cell, blurred; zeros where there was none yet.
      count: () int32 of all objects so far.
      moments: [3, T - 1] moving sums of 1, x and x², where x is what objects gain per
        point after each half turn.
      decisions: half turns that shapes may not have followed yet.
    """

    shapes: jax.Array
    count: jax.Array
    moments: jax.Array
    decisions: Decisions


def start_frame(turns: int = 4) -> Frame:
    """Of nothing yet; T turns of objects, none among them."""
    return Frame(
        jnp.zeros((OBJECTS, CELLS**3)),
        jnp.zeros((), jnp.int32),
        jnp.zeros((3, turns - 1)),
        start_decisions(),
    )


def turn_back(
    winners: Winners,
    points: jax.Array,
    batch: Mapping[str, jax.Array],
    turns: jax.Array,
    frame: Frame,
    *,
    covariance: jax.Array,
    views: int,
    heads: int,
    is_due: jax.Array,
) -> tuple[Winners, Frame, jax.Array]:
    """Half turns of the objects that fit the category better that way.

    Args:
      winners: of B·V views, those of an object side by side.
      points: [B·V, N, 3], for each view of its object.
      batch: view_ids int32 [B·V], by which views are known again.
      turns: [T, 4] half turns of objects. frame: of the batches before.
      covariance: [3, 3] of points, along whose axes objects are moved to fit.
      views: V. heads: K, of the candidates.
      is_due: () whether objects are turned at this step, or counted alone.

    Returns:
      (the winners to learn, the frame with this batch, () share of objects turned).
    """
    points = jax.lax.stop_gradient(points[:, :POINTS])
    ways = list_ways(covariance, is_upright=len(turns) == 2)

    def compare(points):
        scores = judge_cells(points, frame.shapes, frame.count)
        return compare_places(points[:_FITTED], turns, ways, scores)

    fits = jax.vmap(compare)(points)
    gains = (fits[:, 1:] - fits[:, :1]).reshape(-1, views, len(turns) - 1)
    gains = jnp.mean(gains, axis=1)
    wanted, is_fitting = _choose_turns(gains, frame.moments)
    wanted = jnp.where(is_due, wanted, 0)
    found = wanted, is_fitting, winners.poses, turns, batch["view_ids"]
    turned, decisions = keep_turns(frame.decisions, *found)
    # Shapes are counted as they are predicted: turned ones would vote for more of them.
    new = _count_batch(frame, points[::views], gains)
    is_turned = jnp.any(turned.reshape(-1, views) > 0, axis=1)
    winners = winners.turn(turns, turned, heads=heads)
    return winners, new._replace(decisions=decisions), jnp.mean(is_turned)


def _choose_turns(gains, moments):
    """Which half turn [B] objects want, 0 for none; whether [B] they fit so far.

    Only what tells a category from its own half turn counts: objects that look the same
    either way would be turned by chance.
    """
    mean, square = moments[1:] / jnp.maximum(moments[:1], 1e-6)
    mean, spread = mean[None], jnp.sqrt(jnp.maximum(square - mean**2, 0))[None]
    is_clear = mean < -_CLARITY * spread
    # What fits both ways alike is left to its views, or to what was decided before.
    total = jnp.where(is_clear, gains + _MARGIN * mean, -jnp.inf)
    is_fitting = ~is_clear | (gains < _FITTING * mean)
    wanted = jnp.where(jnp.max(total, axis=1) > 0, jnp.argmax(total, axis=1) + 1, 0)
    return wanted, jnp.all(is_fitting, axis=1)


def _count_batch(frame, points, gains):
    """The frame after a batch, of all devices."""
    shapes = jax.lax.all_gather(jax.vmap(count_points)(points), AXIS, tiled=True)
    # Of a batch that is larger than what is remembered, its last objects.
    rows = (frame.count + jnp.arange(len(shapes))[-OBJECTS:]) % OBJECTS
    moments = jnp.stack([jnp.mean(gains**power, axis=0) for power in range(3)])
    return frame._replace(
        shapes=frame.shapes.at[rows].set(shapes[-OBJECTS:]),
        count=frame.count + len(shapes),
        moments=KEPT * frame.moments + jax.lax.pmean(moments, AXIS),
    )


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
