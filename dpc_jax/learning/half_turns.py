"""Rotations by 180° as further pose candidates. Not in the paper.

Most of the remaining errors of an ensemble exchange front and back. So each head's pose
is also tried after turning the object by 180° about each principal axis of the
predicted points; the gradient reaches the head through the fixed turn.
"""

import jax
import jax.numpy as jnp

from dpc_jax.render import quaternion


def average_covariance(
    covariance: jax.Array, current: jax.Array, step: jax.Array
) -> jax.Array:
    """The running covariance [3, 3] after one more batch, whose own is `current`.

    The plain mean at first, then an exponential average over a hundred batches.
    """
    weight = jnp.maximum(0.01, 1 / (step + 1))
    return (1 - weight) * covariance + weight * current


def compute_covariance(
    points: jax.Array, weights: jax.Array | None = None, *, axis: str | None = None
) -> jax.Array:
    """Covariance [3, 3] of points [..., 3], without gradient.

    Args:
      weights: [...], of each point; None for all alike.
      axis: that names devices, each with its share of the points; they get that of all.
    """
    points = jax.lax.stop_gradient(points.reshape(-1, 3))

    def average(value):
        return value if axis is None else jax.lax.pmean(value, axis)

    if weights is None:
        away = points - average(jnp.mean(points, axis=0, keepdims=True))
        moments = jnp.matmul(away.T, away, precision="highest") / points.shape[0]
        return average(moments)
    weights = jax.lax.stop_gradient(weights.reshape(-1))
    total = average(jnp.sum(weights))
    shares = (weights / jnp.maximum(total, jnp.finfo(weights.dtype).tiny))[:, None]
    away = points - average(jnp.sum(shares * points, axis=0, keepdims=True))
    return average(jnp.matmul((shares * away).T, away, precision="highest"))


def find_half_turns(covariance: jax.Array, count: int = 4) -> jax.Array:
    """Half turns about the principal axes of a covariance [3, 3].

    Returns:
      [4, 4] quaternions: the identity, then 180° about each principal axis. With a
      count of two [2, 4]: the identity and 180° about z, up where cameras are upright.
    """
    if count == 2:
        return jnp.eye(4, dtype=covariance.dtype)[jnp.array([0, 3])]
    _, axes = jnp.linalg.eigh(covariance)
    turns = jnp.concatenate([jnp.zeros((3, 1), axes.dtype), axes.T], axis=1)
    return jnp.concatenate([jnp.array([quaternion.IDENTITY], axes.dtype), turns])


def turn_candidates(candidates: jax.Array, turns: jax.Array) -> jax.Array:
    """Each candidate [K, 4] after each turn [T, 4] of the object.

    Returns:
      [T·K, 4]; candidate i of the result comes from head i % K.
    """
    over_candidates = jax.vmap(quaternion.multiply, in_axes=(0, None))
    turned = jax.vmap(over_candidates, in_axes=(None, 0))(candidates, turns)
    return turned.reshape(-1, 4)
