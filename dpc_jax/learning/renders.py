"""Many renders of one step: one after the other, or side by side."""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.learning.point_sizes import split_size
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
) -> jax.Array:
    """Reprojection loss of each pose candidate of one view.

    Args:
      points: [N, 3]. mass: (), of each, in voxels; or [N].
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), in voxels, or sizes of each point, see `point_sizes`.
      renders_at_once: how many candidates are rendered side by side, see `map_renders`.

    Returns:
      [C].
    """
    grid = VoxelGrid(target.shape[0])
    shared, covariance = split_size(jnp.asarray(sigma))

    def compute_loss(candidate):
        image = project(
            points,
            candidate,
            sigma=shared,
            covariance=covariance,
            scale=mass,
            camera=camera,
            grid=grid,
        )
        assert image.silhouette is not None
        return reprojection_loss(image.silhouette, target)

    return map_renders(compute_loss, candidates, renders_at_once=renders_at_once)
