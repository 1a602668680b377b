"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's loss."""

import functools
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose, Render, Train
from dpc_jax.learning import losses, schedules
from dpc_jax.learning.cameras import compute_gauge, predict_cameras
from dpc_jax.learning.choice.teaching import teach_poses
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.predictions import (
    Cells,
    Maps,
    Shapes,
    encode_views,
    predict_shapes,
)
from dpc_jax.learning.signals import read_weights
from dpc_jax.learning.terms import Averages, Term, sum_terms
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera


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
    features = encode_views(params, batch["images"], batch["masks"], network=network)
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
    averages, teaching = teach_poses(
        params,
        batch,
        features,
        shapes,
        cameras,
        keys,
        step,
        averages,
        network=network,
        render=render,
        pose=pose,
        train=train,
    )
    metrics |= teaching.metrics
    learned |= teaching.terms
    if stage.fixed_views:
        from dpc_jax.learning.view_maps import compare_fixed_views  # of a baseline

        assert isinstance(shapes, Maps)
        compared, parts = compare_fixed_views(
            shapes, batch, render=render, weights=read_weights(train)
        )
    else:
        compared, parts, costs = compare_winners(
            shapes,
            teaching.rotations,
            batch,
            render=render,
            train=train,
            stage=stage,
            cameras=cameras,
        )
    if train.pull_weight and isinstance(shapes, Shapes):
        from dpc_jax.learning.silhouette_pull import pull_batch  # where it is asked for

        # Points are drawn to silhouettes once these are seen from the right poses.
        pull = jax.lax.cond(
            step >= train.pull_from * train.steps,
            functools.partial(
                pull_batch,
                masks=batch["masks"],
                side=render.grid,
                camera=camera,
                cameras=cameras,
            ),
            lambda points, rotations: jnp.zeros(()),
            shapes.kept,
            teaching.rotations,
        )
        learned["pull"] = Term(pull, train.pull_weight * render.grid**2)
    if pose.samples:
        from dpc_jax.learning.choice import sampling  # of a baseline alone

        assert teaching.poses is not None and teaching.winners is not None
        drawn, cost = sampling.compare_drawn(
            params,
            teaching.poses,
            teaching.winners,
            costs,
            averages.cost,
            keys,
            network=network,
            weight=pose.prior_weight * render.grid**2,
            entropy_weight=pose.entropy_weight,
        )
        averages = averages._replace(cost=cost)
        learned |= {name: Term(*parts) for name, parts in drawn.items()}
    terms = compute_priors(shapes, step, train=train) | learned
    metrics |= parts | {name: term.value for name, term in terms.items()}
    return compared + sum_terms(terms), (metrics, averages)


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
        # A mean, as the reprojection of all points is: the balance of the two is the
        # same however many points there are.
        terms["repulsion"] = Term(energy, train.repulsion_weight * ramp)
    return terms
