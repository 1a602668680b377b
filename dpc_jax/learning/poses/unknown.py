"""Poses that an ensemble finds, its winner chosen in hindsight (Eq. 2)."""

from dpc_jax.learning.choice.hindsight import choose_poses
from dpc_jax.learning.poses.teaching import Lesson, Teaching, compare_student, predict
from dpc_jax.learning.recipe import Recipe


def teach(lesson: Lesson, *, recipe: Recipe) -> Teaching:
    """The candidates that explain the views best, which teach the student."""
    averages, poses = predict(lesson, recipe=recipe)
    batch, cameras, pose = lesson.batch, lesson.cameras, recipe.pose
    winners = choose_poses(
        lesson.shapes, poses.candidates, batch, cameras, recipe=recipe
    )
    metrics, cloud = {}, lesson.shapes.find_cloud()
    if pose.finds_frame and cloud is not None:
        from dpc_jax.learning.choice import common_frame  # where it is asked for

        winners, frame, metrics["turned_back"] = common_frame.turn_back(
            winners,
            cloud,
            batch["images"],
            batch["masks"],
            averages.covariance,
            averages.frame,
            camera=recipe.camera,
            cameras=cameras,
            heads=pose.learned_heads,
            is_due=lesson.step >= common_frame.BEGIN * recipe.train.steps,
        )
        averages = averages._replace(frame=frame)
    metrics["winners"] = winners.indices.reshape(-1)
    terms = compare_student(poses, winners, recipe=recipe)
    return Teaching(winners.poses, terms, metrics, lambda _: (averages, {}))
