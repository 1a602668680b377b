"""Poses learned from labels in the data, shapes from the labelled poses (Table 2)."""

import jax
import jax.numpy as jnp

from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.losses import Term
from dpc_jax.learning.poses.source import (
    ForwardPass,
    ViewPoses,
    compare_student,
    predict_candidates,
)
from dpc_jax.learning.predictions import Poses
from dpc_jax.learning.recipe import Recipe
from dpc_jax.render import quaternion


def find_poses(forward: ForwardPass, *, recipe: Recipe) -> ViewPoses:
    """The labels, which the nearest candidate of each view learns."""
    averages, poses = predict_candidates(forward, recipe=recipe)
    winners, terms = compare_labels(poses, forward.batch["quaternions"], recipe=recipe)
    metrics = {"winners": winners.indices}
    terms |= compare_student(poses, winners, recipe=recipe)
    return ViewPoses(winners.poses, terms, metrics, lambda _: (averages, {}))


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
