"""Which pose a view is rendered from, and the losses it is learned by.

They are given, or those of an ensemble whose winner images choose in hindsight (Eq. 2),
labels in the data (Table 2), or chance (`sampled`).
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning import losses
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.candidates import (
    Poses,
    average_covariance,
    complete_poses,
    compute_covariance,
    find_half_turns,
)
from dpc_jax.learning.choice.hindsight import Winners, choose_poses
from dpc_jax.learning.losses import Term
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.learning.schedules import is_framing
from dpc_jax.learning.shapes import Shape
from dpc_jax.render import quaternion


class ForwardPass(NamedTuple):
    """What the network predicts for a batch; of this a source of poses finds them.

    Attributes:
      params, step, averages: as of `objective.compute_loss`.
      batch: its arrays of all n = B·V views. keys: [n]. views: V of each object.
      features: [n, F] of the views. cameras: of the views, predicted.
      shapes: each predicted from another view of the same object.
    """

    params: Mapping
    batch: dict[str, jax.Array]
    views: int
    features: jax.Array
    shapes: Shape
    cameras: Cameras
    keys: jax.Array
    step: jax.Array
    averages: Averages


class ViewPoses(NamedTuple):
    """The poses of a batch's views, and the losses they are learned by.

    Attributes:
      rotations: [n, 4] that views are rendered from.
      terms: losses of the poses by name. metrics: by name.
      find_cost_terms: of the costs [n] of these renders, the averages after this
        batch and the losses that depend on the costs.
    """

    rotations: jax.Array
    terms: dict[str, Term]
    metrics: dict[str, jax.Array]
    find_cost_terms: Callable[[jax.Array | None], tuple[Averages, dict[str, Term]]]


def find_poses(forward: ForwardPass, *, recipe: Recipe) -> ViewPoses:
    """Poses of a batch, and what they are learned by."""
    source = recipe.pose.source
    if source == "given":  # § Estimating shape with known pose
        poses = forward.batch["quaternions"]
        return ViewPoses(poses, {}, {}, lambda _: (forward.averages, {}))
    if source == "sampled":
        from dpc_jax.learning.poses import sampled  # where it is asked for

        return sampled.find_poses(forward, recipe=recipe)
    averages, poses = predict_candidates(forward, recipe=recipe)
    batch, metrics, terms = forward.batch, {}, {}
    if source == "labels":
        winners, terms = compare_labels(poses, batch["quaternions"], recipe=recipe)
    else:
        seen = batch, forward.cameras
        winners = choose_poses(forward.shapes, poses.candidates, *seen, recipe=recipe)
        if averages.frame is not None:
            winners, frame, metrics["turned_back"] = _turn_back(
                winners, forward, averages, recipe
            )
            averages = averages._replace(frame=frame)
    metrics["winners"] = winners.indices
    terms |= compare_student(poses, winners, recipe=recipe)
    return ViewPoses(winners.poses, terms, metrics, lambda _: (averages, {}))


def _turn_back(winners, forward, averages, recipe):
    """(winners, the frame after the batch, share turned) by `pose.common_frame`."""
    by_colors, steps = recipe.pose.common_frame == "colors", recipe.train.steps
    turns = find_half_turns(averages.covariance, recipe.pose.turns)
    seen = forward.batch, turns, averages.frame
    how = {
        "heads": recipe.pose.learned_heads,
        "is_due": is_framing(forward.step, steps=steps, by_colors=by_colors),
    }
    if by_colors:  # each is loaded where it is asked for
        from dpc_jax.learning.choice.colors import turn_views as turn

        how |= {"camera": recipe.camera, "cameras": forward.cameras}
    else:
        from dpc_jax.learning.choice.common_frame import turn_back as turn

        how |= {"covariance": averages.covariance, "views": forward.views}
    return turn(winners, forward.shapes.find_cloud(), *seen, **how)


def predict_candidates(
    forward: ForwardPass, *, recipe: Recipe
) -> tuple[Averages, Poses]:
    """The candidates of all views, turned ones included, and the student's output."""
    averages, pose = forward.averages, recipe.pose
    if pose.half_turns:
        places, weights = forward.shapes.find_places()
        current = compute_covariance(places, weights)
        covariance = average_covariance(averages.covariance, current, forward.step)
        averages = averages._replace(covariance=covariance)
    output = recipe.network.apply(
        forward.params, forward.features, method="predict_pose"
    )
    assert isinstance(output, dict)
    return averages, complete_poses(output, averages.covariance, pose=pose)


def compare_labels(
    poses: Poses, labels: jax.Array, *, recipe: Recipe
) -> tuple[Winners, dict[str, Term]]:
    """The candidates nearest to the labels [n, 4] by their angle, and their loss.

    It is the hindsight choice with labels in place of images.
    """
    # An angle's gradient has one length: large errors shrink as fast as small ones.
    to_label = jax.vmap(quaternion.angle_between, in_axes=(0, None))
    angles = jax.vmap(to_label)(poses.candidates, labels)
    nearest = jnp.argmin(angles, axis=1)
    loss = jnp.mean(jnp.take_along_axis(angles, nearest[:, None], axis=1))
    winners = Winners(labels, nearest)
    weight = recipe.pose.student_weight * recipe.render.grid**2
    return winners, {"labels": Term(loss, weight)}


def compare_student(
    poses: Poses, winners: Winners, *, recipe: Recipe
) -> dict[str, Term]:
    """The student's loss with the hindsight winners as teachers (§ distilled ensemble).

    With logits it is the cross entropy, in nats, of a student that selects; K = 1 has
    no student.
    """
    pose = recipe.pose
    if pose.learned_heads < 2:
        return {}
    if poses.logits is not None:
        entropy = optax.losses.softmax_cross_entropy_with_integer_labels
        loss = jnp.mean(entropy(poses.logits, winners.indices))
    else:
        assert poses.student is not None
        form = "squared" if pose.student == "squares" else "absolute"
        compare = functools.partial(losses.student_loss, form=form)
        loss = jnp.mean(jax.vmap(compare)(poses.student, winners.poses))
    return {"student": Term(loss, pose.student_weight * recipe.render.grid**2)}
