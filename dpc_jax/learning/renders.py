"""Many renders of one step: one after the other, or side by side."""

from collections.abc import Mapping

import chex
import jax
import jax.numpy as jnp

from dpc_jax.learning.point_sizes import split_size
from dpc_jax.learning.signals import SILHOUETTES, Weights, compare_images
from dpc_jax.render import Camera, VoxelGrid, project
from dpc_jax.render.batch import map_renders
from dpc_jax.render.devices import AUTOMATIC


def compute_candidate_losses(
    points: jax.Array,
    mass: chex.Numeric,
    candidates: jax.Array,
    target: jax.Array,
    *,
    sigma: chex.Numeric,
    camera: Camera,
    renders_at_once: int = AUTOMATIC,
    translation: jax.Array | None = None,
    colors: jax.Array | None = None,
    others: Mapping[str, jax.Array] | None = None,
    weights: Weights = SILHOUETTES,
) -> jax.Array:
    """Loss of each pose candidate of one view, by its silhouette or by more signals.

    Args:
      points: [N, 3]. mass: (), of each, in voxels; or [N].
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), in voxels, or sizes of each point, see `point_sizes`.
      renders_at_once: how many candidates are rendered side by side, see `map_renders`.
      translation: [3] of the object in the camera frame.
      colors: [N, 3], others: targets of other signals by name (`make_targets`), as the
        weights need them.
      weights: of the signals.

    Returns:
      [C].
    """
    grid = VoxelGrid(target.shape[0])
    shared, covariance = split_size(jnp.asarray(sigma))

    targets = {"silhouette": target, **(others or {})}

    def compute_loss(candidate):
        image = project(
            points,
            candidate,
            sigma=shared,
            covariance=covariance,
            scale=mass,
            colors=colors,
            translation=translation,
            camera=camera,
            grid=grid,
            signals=weights.renders,
        )
        return compare_images(image, targets, weights=weights, camera=camera)[0]

    return map_renders(compute_loss, candidates, renders_at_once=renders_at_once)
