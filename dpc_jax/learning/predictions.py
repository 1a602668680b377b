"""What the network predicts for a batch: shapes, pose candidates, cameras."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose, Render
from dpc_jax.learning.half_turns import find_half_turns, turn_candidates
from dpc_jax.learning.shapes import Shape, find_shape_class
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
    images: jax.Array, masks: jax.Array, *, network: ShapePoseNetwork
) -> jax.Array:
    """What the network sees of images uint8 [..., S, S, 3] with masks [..., S, S].

    Bytes 0 to 255 become numbers from -1 to 1.
    """
    inputs = images.astype(jnp.float32) / 127.5 - 1
    if not network.sees_mask:
        return inputs
    own = masks.astype(jnp.float32) / 127.5 - 1
    return jnp.concatenate([inputs, own[..., None]], axis=-1)


def encode_views(
    params: Mapping, images: jax.Array, masks: jax.Array, *, network: ShapePoseNetwork
) -> jax.Array:
    """Features [B, V, F] of images uint8 [B, V, S, S, 3] with masks [B, V, S, S]."""
    inputs = make_inputs(images, masks, network=network)
    flat = inputs.reshape(-1, *inputs.shape[2:])
    features = network.apply(params, flat, method="encode")
    assert isinstance(features, jax.Array)
    return features.reshape(*images.shape[:2], -1)


def predict_shapes(
    params: Mapping,
    features: jax.Array,
    keys: jax.Array,
    sigma: jax.Array,
    *,
    network: ShapePoseNetwork,
    render: Render,
    kept_points: int,
) -> Shape:
    """The shape of each object from its features [B, F], with point dropout.

    Args:
      keys: [B], of the objects. sigma: (), of the schedule.
    """
    output = network.apply(params, features, method="predict_shape")
    assert isinstance(output, dict)
    shapes = find_shape_class(network.shape_kind).read(output, sigma, render=render)
    return shapes.drop(keys, kept_points)


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
