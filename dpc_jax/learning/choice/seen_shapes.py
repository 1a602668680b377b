"""Where the points of other objects are, and how an object fits them."""

import jax
import jax.numpy as jnp

from dpc_jax.render import quaternion

CELLS = 12  # along each axis of the object frame
OBJECTS = 256  # the last ones, whose points are remembered
_ALIKE = 0.2  # share of these objects, the most like one, that do not judge it
_EMPTY = 0.02  # density that is added, of the mean over the cells
_BLUR = (0.12, 0.76, 0.12)  # of densities, along each axis
_SHIFTS = tuple(0.04 * i for i in range(-5, 6))  # along each axis, box diagonals
_SCALES = (0.8, 1.0, 1.25)


def count_points(points: jax.Array) -> jax.Array:
    """Share of points [N, 3] in each cell, blurred; [CELLS³]."""
    density = jnp.zeros(CELLS**3).at[find_cells(points)].add(1 / len(points))
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
    away = jnp.sum((shapes - count_points(points)[None]) ** 2, axis=1)
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
    shifts = (jnp.array(_SHIFTS)[:, None, None] * ways[None]).reshape(1, -1, 1, 3)

    def fit(turn):
        turned = quaternion.rotate(points, turn)
        scaled = jnp.array(_SCALES)[:, None, None, None] * turned[None, None]
        places = scaled + shifts
        is_inside = jnp.all(jnp.abs(places) < 0.5, axis=-1)
        found = scores[find_cells(places.reshape(-1, 3))].reshape(is_inside.shape)
        return jnp.max(jnp.mean(jnp.where(is_inside, found, jnp.log(_EMPTY)), axis=-1))

    return jax.vmap(fit)(turns)


def find_cells(places: jax.Array) -> jax.Array:
    """Cells [n] int32 of places [n, 3]."""
    x, y, z = jnp.clip(jnp.floor((places + 0.5) * CELLS), 0, CELLS - 1).T
    return ((x * CELLS + y) * CELLS + z).astype(jnp.int32)
