"""Poses that an ensemble finds, its winner chosen in hindsight (Eq. 2)."""

from dpc_jax.learning.choice.hindsight import choose_poses
from dpc_jax.learning.poses.source import (
    ForwardPass,
    ViewPoses,
    compare_student,
    predict_candidates,
)
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.schedules import is_framing


def find_poses(forward: ForwardPass, *, recipe: Recipe) -> ViewPoses:
    """The candidates that explain the views best, which teach the student."""
    averages, poses = predict_candidates(forward, recipe=recipe)
    batch, cameras, pose = forward.batch, forward.cameras, recipe.pose
    winners = choose_poses(
        forward.shapes, poses.candidates, batch, cameras, recipe=recipe
    )
    metrics = {}
    if averages.frame is not None:
        from dpc_jax.learning.choice import common_frame  # where it is asked for

        steps, by_colors = recipe.train.steps, averages.frame.colors is not None
        winners, frame, metrics["turned_back"] = common_frame.turn_back(
            winners,
            forward.shapes.find_cloud(),
            batch,
            averages.covariance,
            averages.frame,
            camera=recipe.camera,
            cameras=cameras,
            views=forward.views,
            heads=pose.learned_heads,
            is_due=is_framing(forward.step, steps=steps, by_colors=by_colors),
        )
        averages = averages._replace(frame=frame)
    metrics["winners"] = winners.indices
    terms = compare_student(poses, winners, recipe=recipe)
    return ViewPoses(winners.poses, terms, metrics, lambda _: (averages, {}))
