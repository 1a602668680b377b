"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
rendered without a gradient, and only the winner is rendered again with one.
"""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.learning.losses import reprojection_loss, student_loss
from dpc_jax.render import Camera, VoxelGrid, project, quaternion


def find_half_turns(points: chex.Array) -> chex.Array:
    """Half turns about the principal axes of a set of points.

    Args:
      points: [N, 3].

    Returns:
      [4, 4] quaternions: the identity, then 180° about each principal axis.
    """
    centred = points - jnp.mean(points, axis=0)
    _, axes = jnp.linalg.eigh(centred.T @ centred)
    turns = jnp.concatenate([jnp.zeros((3, 1), points.dtype), axes.T], axis=1)
    identity = jnp.array([quaternion.IDENTITY], points.dtype)
    return jax.lax.stop_gradient(jnp.concatenate([identity, turns]))


def turn_candidates(candidates: chex.Array, turns: chex.Array) -> chex.Array:
    """Each candidate after each turn of the object.

    Args:
      candidates: [K, 4] quaternions. turns: [T, 4].

    Returns:
      [T·K, 4]; candidate i of the result is head i % K.
    """
    turned = jax.vmap(
        lambda turn: jax.vmap(lambda q: quaternion.multiply(q, turn))(candidates)
    )(turns)
    return turned.reshape(-1, 4)


def choose_candidate(
    points: chex.Array,
    mass: chex.Array,
    candidates: chex.Array,
    target: chex.Array,
    *,
    sigma: chex.Array,
    camera: Camera,
    grid: VoxelGrid,
    student: chex.Array | None = None,
    tie_break: float = 0.0,
) -> tuple[chex.Array, chex.Array]:
    """Index of the candidate whose silhouette fits one view best (Eq. 2).

    Args:
      points: [N, 3]. mass: (), of each, in voxels of `grid`.
      candidates: [C, 4] quaternions.
      target: [rows, cols] silhouette.
      sigma: (), in voxels. camera, grid: see `project`.
      student: [4], the student's quaternion, needed where tie_break > 0.
      tie_break: each loss grows by this share for a candidate orthogonal to the
        student's pose. Views of near-equal silhouette (front and back) are then told
        apart as the student has learned from the others. Not in the paper.

    Returns:
      (() index of the winner, [C] losses without the tie break).
    """

    def compute_loss(candidate):
        image = project(
            points, candidate, sigma=sigma, scale=mass, camera=camera, grid=grid
        )
        return reprojection_loss(image.silhouette, target)

    losses = jax.vmap(compute_loss)(candidates)
    preferred = losses
    if tie_break:
        distance = jax.vmap(student_loss, (None, 0))(student, candidates)
        preferred = losses * (1 + tie_break * distance)
    return jnp.argmin(jax.lax.stop_gradient(preferred)), losses
