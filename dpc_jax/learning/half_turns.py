"""Rotations by 180° as further pose candidates. Not in the paper.

Most of the remaining errors of an ensemble exchange front and back. So each head's pose
is also tried after turning the object by 180° about each principal axis of the
predicted points; the gradient reaches the head through the fixed turn.
"""

import jax
import jax.numpy as jnp

from dpc_jax.render import quaternion


def average_covariance(
    covariance: jax.Array,
    points: jax.Array,
    step: jax.Array,
    *,
    weights: jax.Array | None = None,
    axis: str | None = None,
) -> jax.Array:
    """The running covariance [3, 3] after one more batch of points [..., 3].

    Weights are [...], of each point; None for all alike.

    The plain mean at first, then an exponential average over a hundred batches.
    Devices along a named axis, each with its share of the batch, get that of all.
    """
    weight = jnp.maximum(0.01, 1 / (step + 1))
    if weights is not None:
        weights = weights.reshape(-1)
    current = compute_covariance(points.reshape(-1, 3), weights, axis=axis)
    return (1 - weight) * covariance + weight * current


def compute_covariance(
    points: jax.Array, weights: jax.Array | None = None, *, axis: str | None = None
) -> jax.Array:
    """Covariance [3, 3] of points [N, 3], without gradient; the rest as above."""
    points, weights = jax.lax.stop_gradient((points, weights))
    if weights is not None:
        return _weigh_covariance(points, weights, axis)
    centre = _average(jnp.mean(points, axis=0, keepdims=True), axis)
    away = points - centre
    moments = jnp.matmul(away.T, away, precision="highest") / points.shape[0]
    return _average(moments, axis)


def _weigh_covariance(points, weights, axis):
    total = _average(jnp.sum(weights), axis)
    shares = (weights / jnp.maximum(total, jnp.finfo(weights.dtype).tiny))[:, None]
    centre = _average(jnp.sum(shares * points, axis=0, keepdims=True), axis)
    away = points - centre
    return _average(jnp.matmul((shares * away).T, away, precision="highest"), axis)


def _average(value, axis):
    return value if axis is None else jax.lax.pmean(value, axis)


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
    """Each candidate after each turn of the object.

    Args:
      candidates: [K, 4] quaternions. turns: [T, 4].

    Returns:
      [T·K, 4]; candidate i of the result comes from head i % K.
    """
    over_candidates = jax.vmap(quaternion.multiply, in_axes=(0, None))
    turned = jax.vmap(over_candidates, in_axes=(None, 0))(candidates, turns)
    return turned.reshape(-1, 4)
