"""Which pose a view is rendered from, and the losses it is learned by.

A source of poses is a function `find_poses` of these arguments, in a file of its own:
`labels`, `unknown` (the ensemble in hindsight) and `sampled`. Poses that are given need
none.
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning import losses
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.half_turns import average_covariance, compute_covariance
from dpc_jax.learning.losses import Term
from dpc_jax.learning.predictions import Poses, complete_poses
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.learning.shapes import Shape


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
    """Poses of a batch; only their source is loaded."""
    source = recipe.pose.source
    if source == "given":  # § Estimating shape with known pose
        poses = forward.batch["quaternions"]
        return ViewPoses(poses, {}, {}, lambda _: (forward.averages, {}))
    if source == "labels":
        from dpc_jax.learning.poses import labels as chosen
    elif source == "sampled":
        from dpc_jax.learning.poses import sampled as chosen
    else:
        from dpc_jax.learning.poses import unknown as chosen
    return chosen.find_poses(forward, recipe=recipe)


def predict_candidates(
    forward: ForwardPass, *, recipe: Recipe
) -> tuple[Averages, Poses]:
    """The candidates of all views, turned ones included, and the student's output."""
    averages, pose = forward.averages, recipe.pose
    if pose.half_turns:
        places, weights = forward.shapes.find_places()
        current = compute_covariance(places, weights, axis=AXIS)
        covariance = average_covariance(averages.covariance, current, forward.step)
        averages = averages._replace(covariance=covariance)
    output = recipe.network.apply(
        forward.params, forward.features, method="predict_pose"
    )
    assert isinstance(output, dict)
    return averages, complete_poses(output, averages.covariance, pose=pose)


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
