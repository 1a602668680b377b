"""Which pose a view is rendered from, and what pose heads and student learn of it."""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose, Render, Train
from dpc_jax.learning import losses
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.choice.batch_choice import Winners, choose_poses
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.half_turns import average_covariance
from dpc_jax.learning.predictions import (
    Cells,
    Maps,
    Poses,
    Shapes,
    find_places,
    predict_poses,
)
from dpc_jax.learning.signals import read_weights
from dpc_jax.learning.terms import Averages, Term
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera


class Teaching(NamedTuple):
    """What a batch teaches about poses.

    Attributes:
      rotations: [B, V, 4] that views are rendered from.
      terms: losses of the poses by name. metrics: by name.
      poses, winners: predicted and chosen; None where they are known.
    """

    rotations: jax.Array
    terms: dict[str, Term]
    metrics: dict[str, jax.Array]
    poses: Poses | None = None
    winners: Winners | None = None


def teach_poses(
    params: Mapping,
    batch: dict[str, jax.Array],
    features: jax.Array,
    shapes: Shapes | Cells | Maps,
    cameras: Cameras,
    keys: jax.Array,
    step: jax.Array,
    averages: Averages,
    *,
    network: ShapePoseNetwork,
    render: Render,
    pose: Pose,
    train: Train,
) -> tuple[Averages, Teaching]:
    """Poses of a batch: given, or chosen among the candidates of its views.

    Args:
      features: [B, V, F] of the views; the rest as of `objective.compute_loss`.

    Returns:
      (the averages after this batch, what it teaches).
    """
    if pose.known:
        return averages, Teaching(batch["quaternions"], {}, {})
    assert not isinstance(shapes, Maps)  # poses are known
    covariance = averages.covariance
    if pose.half_turns:
        places, weights = find_places(shapes)
        covariance = average_covariance(
            covariance, places, step, weights=weights, axis=AXIS
        )
    averages = averages._replace(covariance=covariance)
    poses = predict_poses(params, features, covariance, network=network, pose=pose)
    terms, metrics = {}, {}
    if pose.labels:
        labels = batch["quaternions"]
        winners, terms = compare_labels(poses, labels, render=render, pose=pose)
    elif pose.samples:
        from dpc_jax.learning.choice import sampling  # of a baseline alone

        winners = sampling.draw_poses(poses, keys, views=features.shape[1])
    else:
        winners = choose_poses(
            shapes,
            poses.candidates,
            batch["masks"],
            camera=Camera(render.focal_length, render.distance),
            render=render,
            pose=pose,
            cameras=cameras,
            views=batch,
            weights=read_weights(train),
        )
    if pose.finds_frame and isinstance(shapes, Shapes):
        from dpc_jax.learning.choice import common_frame  # where it is asked for

        winners, frame, metrics["turned_back"] = common_frame.turn_back(
            winners,
            shapes.points,
            batch["images"],
            batch["masks"],
            covariance,
            averages.frame,
            camera=Camera(render.focal_length, render.distance),
            cameras=cameras,
            heads=pose.heads,
            is_due=step >= pose.common_frame_from * train.steps,
        )
        averages = averages._replace(frame=frame)
    metrics["winners"] = winners.indices.reshape(-1)
    if not pose.samples:
        terms |= compare_student(poses, winners, render=render, pose=pose)
    return averages, Teaching(winners.poses, terms, metrics, poses, winners)


def compare_labels(
    poses: Poses, labels: jax.Array, *, render: Render, pose: Pose
) -> tuple[Winners, dict[str, Term]]:
    """The candidates nearest to the labels [B, V, 4], and their loss.

    The hindsight choice with labels in place of images: of each view's candidates the
    nearest one learns, by the angle to its label.
    """
    targets = labels.reshape(-1, 4)
    to_label = jax.vmap(losses.geodesic_loss, in_axes=(0, None))
    angles = jax.vmap(to_label)(poses.candidates, targets)
    nearest = jnp.argmin(angles, axis=1)
    loss = jnp.mean(jnp.take_along_axis(angles, nearest[:, None], axis=1))
    winners = Winners(labels, nearest.reshape(labels.shape[:2]))
    weight = pose.student_weight * render.grid**2
    return winners, {"labels": Term(loss, weight)}


def compare_student(
    poses: Poses, winners: Winners, *, render: Render, pose: Pose
) -> dict[str, Term]:
    """The student's loss with the hindsight winners as teachers (§ distilled ensemble).

    With logits it is the cross entropy of a student that selects (the default). A
    single regressor (K = 1) needs no student.
    """
    if pose.heads < 2:
        return {}
    if poses.logits is not None:
        loss = losses.selection_loss(poses.logits, winners.indices.reshape(-1))
    else:
        assert poses.student is not None
        teachers = winners.poses.reshape(-1, 4)
        compare = functools.partial(losses.student_loss, form=pose.student_loss)
        loss = jnp.mean(jax.vmap(compare)(poses.student, teachers))
    return {"student": Term(loss, pose.student_weight * render.grid**2)}
