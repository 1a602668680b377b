"""Which pose a view is rendered from, and what is learned of it: the common part.

A source of poses is a function `teach` of these arguments, in a file of its own:
`labels`, `unknown` (the ensemble in hindsight) and `sampled`. Poses that are given need
none.
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning import losses
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.half_turns import average_covariance, compute_covariance
from dpc_jax.learning.predictions import Poses, complete_poses
from dpc_jax.learning.recipe import Averages, Recipe, Term
from dpc_jax.learning.shapes import Shape


class Lesson(NamedTuple):
    """What a source of poses is asked about.

    Attributes:
      params, batch, keys, step, averages: as of `objective.compute_loss`.
      features: [B, V, F] of the views. shapes, cameras: predicted.
    """

    params: Mapping
    batch: dict[str, jax.Array]
    features: jax.Array
    shapes: Shape
    cameras: Cameras
    keys: jax.Array
    step: jax.Array
    averages: Averages


Settle = Callable[[jax.Array | None], tuple[Averages, dict[str, Term]]]


class Teaching(NamedTuple):
    """What a batch teaches about poses.

    Attributes:
      rotations: [B, V, 4] that views are rendered from.
      terms: losses of the poses by name. metrics: by name.
      settle: of the costs [B·V] of these renders, the averages after this batch and the
        losses that depend on the costs.
    """

    rotations: jax.Array
    terms: dict[str, Term]
    metrics: dict[str, jax.Array]
    settle: Settle


def teach_poses(lesson: Lesson, *, recipe: Recipe) -> Teaching:
    """Poses of a batch; only their source is loaded."""
    source = recipe.pose.source
    if source == "given":  # § Estimating shape with known pose
        poses = lesson.batch["quaternions"]
        return Teaching(poses, {}, {}, lambda _: (lesson.averages, {}))
    if source == "labels":
        from dpc_jax.learning.poses.labels import teach
    elif source == "sampled":
        from dpc_jax.learning.poses.sampled import teach
    else:
        from dpc_jax.learning.poses.unknown import teach
    return teach(lesson, recipe=recipe)


def predict(lesson: Lesson, *, recipe: Recipe) -> tuple[Averages, Poses]:
    """The candidates of all views, turned ones included, and the student's output."""
    averages, pose = lesson.averages, recipe.pose
    if pose.half_turns:
        places, weights = lesson.shapes.find_places()
        current = compute_covariance(places, weights, axis=AXIS)
        covariance = average_covariance(averages.covariance, current, lesson.step)
        averages = averages._replace(covariance=covariance)
    features = lesson.features.reshape(-1, lesson.features.shape[-1])
    output = recipe.network.apply(lesson.params, features, method="predict_pose")
    assert isinstance(output, dict)
    return averages, complete_poses(output, averages.covariance, pose=pose)


def compare_student(
    poses: Poses, winners: Winners, *, recipe: Recipe
) -> dict[str, Term]:
    """The student's loss with the hindsight winners as teachers (§ distilled ensemble).

    With logits it is the cross entropy of a student that selects; K = 1 has no student.
    """
    pose = recipe.pose
    if pose.learned_heads < 2:
        return {}
    if poses.logits is not None:
        loss = losses.selection_loss(poses.logits, winners.indices.reshape(-1))
    else:
        assert poses.student is not None
        teachers = winners.poses.reshape(-1, 4)
        form = "squared" if pose.student == "squares" else "absolute"
        compare = functools.partial(losses.student_loss, form=form)
        loss = jnp.mean(jax.vmap(compare)(poses.student, teachers))
    return {"student": Term(loss, pose.student_weight * recipe.render.grid**2)}
