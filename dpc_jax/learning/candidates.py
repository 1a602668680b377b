"""Pose candidates: those of the heads, and with rotations by 180°.

The rotations are not in the paper. Most of the remaining errors of an ensemble exchange
front and back. So each head's pose is also tried after turning the object by 180° about
each principal axis of the predicted points; the gradient reaches the head through the
fixed turn.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose
from dpc_jax.learning.devices import AXIS
from dpc_jax.render import quaternion


class Poses(NamedTuple):
    """Predicted poses of n views.

    Attributes:
      candidates: [n, C, 4] quaternions; candidate i belongs to head i % K.
      student: [n, 4], or None where there is none.
      logits: [n, C] of a student that selects a candidate, or None.
    """

    candidates: jax.Array
    student: jax.Array | None
    logits: jax.Array | None


def complete_poses(
    output: dict[str, jax.Array], covariance: jax.Array, *, pose: Pose
) -> Poses:
    """Add the turned candidates, and the pose of a student that selects.

    Args:
      output: of the network: candidates [n, K, 4], and student [n, 4] or logits [n, C].
      covariance: [3, 3] of predicted points, whose axes the half turns are about.
    """
    candidates, student = output["candidates"], output.get("student")
    logits = output.get("logits")
    if pose.half_turns:
        turns = find_half_turns(covariance, pose.turns)
        candidates = jax.vmap(turn_candidates, (0, None))(candidates, turns)
    if logits is not None:
        chosen = jnp.argmax(logits, axis=-1)
        student = jnp.take_along_axis(candidates, chosen[:, None, None], axis=1)[:, 0]
    return Poses(candidates, student, logits)


def find_probabilities(poses: Poses) -> jax.Array:
    """Probabilities [n, C] of the candidates, alike where no student selects."""
    if poses.logits is None:
        return jnp.full(poses.candidates.shape[:2], 1 / poses.candidates.shape[1])
    return jax.nn.softmax(poses.logits)


def average_covariance(
    covariance: jax.Array, current: jax.Array, step: jax.Array
) -> jax.Array:
    """The running covariance [3, 3] after one more batch, whose own is `current`.

    The plain mean at first, then an exponential average over a hundred batches.
    """
    weight = jnp.maximum(0.01, 1 / (step + 1))
    return (1 - weight) * covariance + weight * current


def compute_covariance(
    points: jax.Array, weights: jax.Array | None = None
) -> jax.Array:
    """Covariance [3, 3] of points [..., 3] of all devices, without gradient.

    Args:
      weights: [...], of each point; None for all alike.
    """
    points = jax.lax.stop_gradient(points.reshape(-1, 3))
    average = functools.partial(jax.lax.pmean, axis_name=AXIS)
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


def turn_index(index: jax.Array, turn: jax.Array, heads: int) -> jax.Array:
    """The candidate of the same of K heads after one more half turn.

    Candidate i is of head i % K after half turn i // K, and these form a group in which
    the turn a after the turn b is the turn a ^ b.
    """
    return (index // heads ^ turn.astype(jnp.int32)) * heads + index % heads
