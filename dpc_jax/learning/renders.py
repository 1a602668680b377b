"""Many renders of one step: one after the other, or side by side."""

from collections.abc import Callable
from typing import Any

import chex
import jax

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.render import Camera, VoxelGrid, project


def map_renders(function: Callable, inputs: Any, *, renders_at_once: int) -> Any:
    """`vmap` over the leading axis, `renders_at_once` entries at a time (0: all).

    One volume at a time stays in a CPU's cache; a GPU wants all at once.
    """
    if renders_at_once == 0:
        return jax.vmap(function)(inputs)
    if renders_at_once == 1:
        return jax.lax.map(function, inputs)
    return jax.lax.map(function, inputs, batch_size=renders_at_once)


def compute_candidate_losses(
    points: jax.Array,
    mass: chex.Numeric,
    candidates: jax.Array,
    target: jax.Array,
    *,
    sigma: chex.Numeric,
    camera: Camera,
    renders_at_once: int = 1,
) -> jax.Array:
    """Reprojection loss of each pose candidate of one view.

    Args:
      points: [N, 3]. mass: (), of each, in voxels.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), in voxels.
      renders_at_once: how many candidates are rendered side by side, see `map_renders`.

    Returns:
      [C].
    """
    grid = VoxelGrid(target.shape[0])

    def compute_loss(candidate):
        image = project(
            points, candidate, sigma=sigma, scale=mass, camera=camera, grid=grid
        )
        assert image.silhouette is not None
        return reprojection_loss(image.silhouette, target)

    return map_renders(compute_loss, candidates, renders_at_once=renders_at_once)
