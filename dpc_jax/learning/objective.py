"""The objective of a batch: Eq. 1 with the hindsight choice, and the student's."""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.config.settings import Settings
from dpc_jax.learning import hindsight, losses, schedules
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera, VoxelGrid, project
from dpc_jax.render.kernels import sample_gaussian


def scale_images(images: chex.Array) -> chex.Array:
    """Bytes 0..255 to the network's [-1, 1]."""
    return images.astype(jnp.float32) / 127.5 - 1


def compute_mass(scale: chex.Array, sigma: chex.Array, settings: Settings):
    """Mass of a point in voxels from the learned scaling coefficient in (0, 1).

    With the unit "peak" a coefficient of one makes a point on a cell centre fill that
    cell, whatever its size: the coefficient is the c of Eq. 4. With "mass" it is the
    point's mass in voxels, as in the released code.
    """
    if settings.scale_unit == "mass":
        return scale
    return scale / sample_gaussian(jnp.zeros(()), sigma) ** 3


def compute_loss(
    params: chex.ArrayTree,
    batch: dict[str, chex.Array],
    key: chex.PRNGKey,
    step: chex.Array,
    covariance: chex.Array,
    *,
    network: ShapePoseNetwork,
    settings: Settings,
    stage: schedules.Stage,
) -> tuple[chex.Array, tuple[dict[str, chex.Array], chex.Array]]:
    """The training objective of one batch: Eq. 1 with Eq. 2, and the student's loss.

    The shape is predicted from each object's first view and compared with all its
    views; the pose of a view from that view.

    Args:
      params: of the network.
      batch: images uint8 [B, V, S, S, 3], masks uint8 [B, V, S, S], quaternions
        [B, V, 4] (read only where poses are known).
      key: for the point dropout.
      step: ().
      covariance: [3, 3], see `TrainState`.
      network, settings: static.
      stage: of the schedule, static.

    Returns:
      (() loss, (metrics, covariance)). Metrics: reprojection (mean sum of squares of a
      view), student's loss, scale, winners [B·V] int32, and what else is asked for.
    """
    camera = Camera(settings.focal_length, settings.distance)
    grid = VoxelGrid(stage.grid)
    # Sigma and targets of the base grid, which candidates are compared in, and their
    # like in the grid that the winners are rendered in.
    ratio = stage.grid / settings.grid
    sigma = schedules.compute_sigma(step, settings)
    done = step / settings.steps
    batch_size, views = batch["images"].shape[:2]

    images = scale_images(batch["images"])
    features = network.apply(
        params, images.reshape(-1, *images.shape[2:]), method="encode"
    )
    by_object = features.reshape(batch_size, views, -1)
    shape = network.apply(params, by_object[:, 0], method="predict_shape")
    # One subset for all views and candidates of an object, so that the choice among
    # candidates does not depend on the luck of their subsets.
    subset = jax.vmap(
        lambda k: jax.random.permutation(k, settings.num_points)[: stage.kept_points]
    )(jax.random.split(key, batch_size))
    kept = jax.tree.map(
        lambda a: jnp.take_along_axis(a, subset[..., None], axis=1),
        {k: v for k, v in shape.items() if k != "scale"},
    )
    mass = compute_mass(shape["scale"], sigma, settings)
    targets = losses.downsample_images(batch["masks"], settings.grid)
    fine_targets = losses.downsample_images(batch["masks"], stage.grid)
    metrics = {"scale": jnp.mean(shape["scale"])}

    if settings.num_candidates:
        pose = network.apply(params, features, method="predict_pose")
        if settings.flips:
            # The plain mean at first, then one that forgets within a hundred batches.
            weight = jnp.maximum(0.01, 1 / (step + 1))
            current = hindsight.compute_covariance(kept["points"].reshape(-1, 3))
            covariance = (1 - weight) * covariance + weight * current
        pose = complete_poses(pose, covariance, settings)
        poses, winners = _choose_poses(
            pose["candidates"],
            kept["points"],
            mass,
            targets,
            sigma,
            camera,
            settings,
        )
        metrics["winners"] = winners.reshape(-1)
    else:
        poses = batch["quaternions"]

    has_color = settings.color_weight > 0
    signals = ("silhouette", "color") if has_color else ("silhouette",)

    def render(view):
        points, view_mass, rotation, colors = view
        return project(
            points,
            rotation,
            sigma=sigma * ratio,
            scale=view_mass,
            colors=colors,
            camera=camera,
            grid=grid,
            signals=signals,
        )

    def per_view(array):
        return None if array is None else jnp.repeat(array, views, axis=0)

    images_seen = hindsight.map_renders(
        render,
        (
            per_view(kept["points"]),
            per_view(mass * ratio**3),  # the same density in smaller voxels
            poses.reshape(-1, 4),
            per_view(kept.get("colors")),
        ),
        at_once=settings.renders_at_once,
    )

    def compare(predicted, target):
        target = target.reshape(predicted.shape)
        total = losses.reprojection_loss(predicted, target) / (batch_size * views)
        return total / ratio**2  # per pixel of the base grid

    loss = metrics["reprojection"] = compare(images_seen.silhouette, fine_targets)
    if has_color:
        channels = jnp.moveaxis(batch["images"], -1, 2)
        colors = losses.downsample_images(channels, stage.grid)
        metrics["color"] = compare(images_seen.color, jnp.moveaxis(colors, 2, -1))
        loss = loss + settings.color_weight * metrics["color"]
    if settings.containment_weight:
        outside = jnp.mean(jax.vmap(losses.containment_loss)(shape["points"]))
        metrics["containment"] = outside
        loss = loss + settings.containment_weight * outside
    if settings.repulsion_weight:
        repelling = kept["points"][:, : settings.repulsion_points]
        metrics["repulsion"] = jnp.mean(jax.vmap(losses.repulsion_energy)(repelling))
        strength = (
            settings.repulsion_weight
            * settings.num_points
            * jnp.maximum(0, 2 * done - 1)
        )
        loss = loss + strength * metrics["repulsion"]
    if settings.num_candidates > 1:
        if settings.selects:
            student = losses.selection_loss(pose["logits"], winners.reshape(-1))
        else:
            student = jnp.mean(
                jax.vmap(losses.student_loss)(pose["student"], poses.reshape(-1, 4))
            )
        metrics["student"] = student
        loss = loss + settings.student_weight * settings.grid**2 * student
    return loss, (metrics, covariance)


def complete_poses(
    pose: dict[str, chex.Array], covariance: chex.Array, settings: Settings
) -> dict[str, chex.Array]:
    """Add the turned candidates, and the pose of a student that selects.

    Args:
      pose: of the network: candidates [n, K, 4], and student [n, 4] or logits [n, C].
      covariance: [3, 3], see `TrainState`.

    Returns:
      The same with candidates [n, C, 4], of which i belongs to head i % K, and with
      student [n, 4].
    """
    candidates = pose["candidates"]
    if settings.flips:
        turns = hindsight.find_half_turns(covariance)
        candidates = jax.vmap(hindsight.turn_candidates, (0, None))(candidates, turns)
    student = pose.get("student")
    if settings.selects:
        chosen = jnp.argmax(pose["logits"], axis=-1)
        student = jnp.take_along_axis(candidates, chosen[:, None, None], axis=1)[:, 0]
    return pose | {"candidates": candidates, "student": student}


def _choose_poses(candidates, points, mass, targets, sigma, camera, settings):
    """Winning quaternion [B, V, 4] of each view, and its index [B, V]."""
    batch_size, views = targets.shape[:2]
    candidates = candidates.reshape(batch_size, views, -1, 4)
    if candidates.shape[2] == 1:
        return candidates[:, :, 0], jnp.zeros((batch_size, views), jnp.int32)

    def choose(view):
        view_points, view_mass, view_candidates, target = view
        return hindsight.choose_candidate(
            view_points,
            view_mass,
            view_candidates,
            target,
            sigma=sigma,
            camera=camera,
            first_grid=settings.choice_grid,
            first_points=settings.choice_points,
            top=settings.choice_top,
            at_once=settings.renders_at_once,
        )

    per_view = (
        jnp.repeat(points, views, axis=0),
        jnp.repeat(mass, views, axis=0),
        candidates.reshape(batch_size * views, -1, 4),
        targets.reshape(batch_size * views, *targets.shape[2:]),
    )
    winners = hindsight.map_renders(
        choose, jax.lax.stop_gradient(per_view), at_once=settings.renders_at_once
    ).reshape(batch_size, views)
    chosen = jnp.take_along_axis(candidates, winners[..., None, None], axis=2)[:, :, 0]
    return chosen, winners
