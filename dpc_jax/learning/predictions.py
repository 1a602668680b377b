"""What the network predicts for a batch: shapes, pose candidates, cameras."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose
from dpc_jax.learning.framing import Frame, cut_out, frame_by_box
from dpc_jax.learning.half_turns import find_half_turns, turn_candidates
from dpc_jax.networks import ShapePoseNetwork


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


def make_inputs(
    images: jax.Array,
    masks: jax.Array,
    *,
    network: ShapePoseNetwork,
    is_framed: jax.Array | bool = False,
) -> jax.Array:
    """What the network sees of images uint8 [..., S, S, 3] with masks [..., S, S].

    Bytes 0 to 255 become numbers from -1 to 1. Views that `is_framed` [...] says are
    cut out by the boxes of their masks first.
    """
    # What lies beyond an image is white, and nothing of the object.
    away = jnp.concatenate([255 - images, masks[..., None]], axis=-1)
    away = away.astype(jnp.float32) / 127.5
    if is_framed is not False:
        is_framed, box = jnp.asarray(is_framed), frame_by_box(masks)
        centre = jnp.where(is_framed[..., None], box.centre, 0)
        away = cut_out(away, Frame(centre, jnp.where(is_framed, box.side, 1)))
    inputs = 1 - away[..., :3]
    if not network.sees_mask:
        return inputs
    return jnp.concatenate([inputs, away[..., 3:] - 1], axis=-1)


def draw_framed(keys: jax.Array) -> jax.Array:
    """Which views [n] of a batch are framed, by their keys [n]: half.

    The other half shows sizes as they are, which tell more of a shape.
    """
    return jax.vmap(lambda key: jax.random.bernoulli(jax.random.fold_in(key, 1)))(keys)


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
