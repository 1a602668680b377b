"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's loss."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.config import Pose, Render, Train
from dpc_jax.learning import losses, schedules
from dpc_jax.learning.cameras import compute_gauge, predict_cameras
from dpc_jax.learning.choice.hindsight import Winners, choose_poses
from dpc_jax.learning.choice.noise import draw_noise
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.half_turns import average_covariance
from dpc_jax.learning.predictions import (
    Cells,
    Maps,
    Poses,
    Shapes,
    encode_views,
    find_places,
    predict_poses,
    predict_shapes,
)
from dpc_jax.learning.signals import read_weights
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera


class Averages(NamedTuple):
    """Of the batches before; what a step goes on from besides the parameters.

    Attributes:
      covariance: [3, 3] of predicted points, over the last hundred or so batches: its
        principal axes are those of the half turns.
      cost: () of a view; of runs that draw poses, else None.
      frame: of runs with `pose.common_frame`, see `choice.common_frame`; else None.
    """

    covariance: jax.Array
    cost: jax.Array | None = None
    frame: Any = None  # its module is loaded where it is asked for


class Term(NamedTuple):
    """One loss: its value and its weight in the sum."""

    value: jax.Array
    weight: chex.Numeric = 1.0


def compute_loss(
    params: Mapping,
    batch: dict[str, jax.Array],
    keys: jax.Array,
    step: jax.Array,
    averages: Averages,
    *,
    network: ShapePoseNetwork,
    render: Render,
    pose: Pose,
    train: Train,
    stage: schedules.Stage,
) -> tuple[jax.Array, tuple[dict[str, jax.Array], Averages]]:
    """The training objective of one batch (§ Single-view Shape and Pose Estimation).

    The shape is predicted from each object's first view and compared with all its
    views. Each view's pose is predicted from that view itself. To be called inside
    `devices.share`, with a device's share of a batch of the run.

    Args:
      params: of the network.
      batch: images uint8 [B, V, S, S, 3], masks uint8 [B, V, S, S], quaternions
        [B, V, 4] (read only where poses are given), what `list_extras` names, and
        corner_masks and corner_depths [B, 8, S, S] in stages of fixed views.
      keys: [B], for the point dropout of each object.
      step: ().
      averages: of the batches before.
      network, render, pose, train: static.
      stage: the current one of the schedule, static.

    Returns:
      (() loss, (metrics, averages)). Metrics: reprojection (mean sum of
      squares of a view), student's loss, scale, winners [B·V] int32, and the other
      active losses.
    """
    camera = Camera(render.focal_length, render.distance)
    sigma = schedules.compute_sigma(step, render, steps=train.steps)
    covariance, cost, frame = averages
    features = encode_views(params, batch["images"], network=network)
    shapes = predict_shapes(
        params,
        features[:, 0],
        keys,
        sigma,
        network=network,
        kept_points=stage.kept_points,
        scale_unit=render.scale_unit,
        grid=render.grid,
    )
    cameras = predict_cameras(params, features, batch, network=network, pose=pose)
    metrics = {"scale": jnp.mean(shapes.scale)}
    learned = {}
    if pose.gauge_weight and (pose.translation or pose.focal_length):
        gauge = compute_gauge(cameras, camera, pose=pose)
        learned["gauge"] = Term(gauge, pose.gauge_weight * render.grid**2)
    if pose.known:
        rotations = batch["quaternions"]
    else:
        assert not isinstance(shapes, Maps)  # poses are known
        if pose.half_turns:
            places, weights = find_places(shapes)
            covariance = average_covariance(
                covariance, places, step, weights=weights, axis=AXIS
            )
        poses = predict_poses(params, features, covariance, network=network, pose=pose)
        if pose.labels:
            rotations = batch["quaternions"]
            winners, labelled = compare_labels(
                poses, rotations, render=render, pose=pose
            )
            learned |= labelled
        elif pose.samples:
            from dpc_jax.learning.choice import sampling  # of a baseline alone

            winners = sampling.draw_poses(poses, keys, views=features.shape[1])
            rotations = winners.poses
        else:
            winners = choose_poses(
                shapes,
                poses.candidates,
                batch["masks"],
                camera=camera,
                render=render,
                pose=pose,
                cameras=cameras,
                views=batch,
                weights=read_weights(train),
                noise=draw_noise(
                    keys,
                    step,
                    poses.candidates.shape[:2],
                    pose=pose,
                    steps=train.steps,
                ),
            )
            if pose.finds_frame:
                from dpc_jax.learning.choice import common_frame  # where asked for

                assert isinstance(shapes, Shapes)
                winners, frame, turned = common_frame.turn_back(
                    winners,
                    shapes.points,
                    batch["images"],
                    batch["masks"],
                    covariance,
                    frame,
                    camera=camera,
                    cameras=cameras,
                    heads=pose.heads,
                    is_due=step >= pose.common_frame_from * train.steps,
                )
                metrics["turned_back"] = turned
            rotations = winners.poses
        metrics["winners"] = winners.indices.reshape(-1)
        if not pose.samples:
            learned |= compare_student(poses, winners, render=render, pose=pose)
    if stage.fixed_views:
        from dpc_jax.learning.view_maps import compare_fixed_views  # of a baseline

        assert isinstance(shapes, Maps)
        compared, parts = compare_fixed_views(
            shapes, batch, render=render, weights=read_weights(train)
        )
    else:
        compared, parts, costs = compare_winners(
            shapes,
            rotations,
            batch,
            render=render,
            train=train,
            stage=stage,
            cameras=cameras,
        )
    if train.pull_weight and isinstance(shapes, Shapes):
        from dpc_jax.learning.silhouette_pull import pull_batch  # where it is asked for

        pull = pull_batch(
            shapes.kept,
            rotations,
            batch["masks"],
            side=render.grid,
            camera=camera,
            cameras=cameras,
        )
        learned["pull"] = Term(pull, train.pull_weight * render.grid**2)
    if pose.samples:
        drawn, cost = sampling.compare_drawn(
            params,
            poses,
            winners,
            costs,
            cost,
            keys,
            network=network,
            weight=pose.prior_weight * render.grid**2,
            entropy_weight=pose.entropy_weight,
        )
        learned |= {name: Term(*parts) for name, parts in drawn.items()}
    terms = compute_priors(shapes, step, train=train) | learned
    metrics |= parts | {name: term.value for name, term in terms.items()}
    return compared + sum_terms(terms), (metrics, Averages(covariance, cost, frame))


def compute_priors(
    shapes: Shapes | Cells | Maps, step: jax.Array, *, train: Train
) -> dict[str, Term]:
    """Regularisers of points, 0 where they have no weight yet. Not in the paper."""
    terms = {}
    if not isinstance(shapes, Shapes):
        return terms
    if train.containment_weight:
        outside = jnp.mean(jax.vmap(losses.containment_loss)(shapes.points))
        terms["containment"] = Term(outside, train.containment_weight)
    if train.repulsion_weight:
        # Ramped up over the second half, once shapes have formed.
        ramp = jnp.maximum(0, 2 * (step / train.steps) - 1)
        energy = jax.lax.cond(
            ramp > 0,
            lambda points: jnp.mean(jax.vmap(losses.repulsion_energy)(points)),
            lambda _: jnp.zeros(()),
            shapes.kept[:, : train.repulsion_points],
        )
        num_points = shapes.points.shape[1]
        terms["repulsion"] = Term(energy, train.repulsion_weight * num_points * ramp)
    return terms


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


def sum_terms(terms: dict[str, Term]) -> jax.Array:
    """The weighted sum; ()."""
    total = jnp.zeros(())
    for term in terms.values():
        total = total + term.weight * term.value
    return total
