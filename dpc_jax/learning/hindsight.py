"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
rendered without a gradient, and only the winner is rendered again with one.
"""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.render import Camera, VoxelGrid, checks, project, quaternion


def map_renders(function, inputs, *, at_once: int):
    """`vmap` over the leading axis, `at_once` entries at a time (0: all).

    One volume at a time stays in a CPU's cache; a GPU wants all at once.
    """
    if at_once == 0:
        return jax.vmap(function)(inputs)
    if at_once == 1:
        return jax.lax.map(function, inputs)
    return jax.lax.map(function, inputs, batch_size=at_once)


def compute_covariance(points: chex.Array) -> chex.Array:
    """Covariance [3, 3] of points [N, 3], without gradient."""
    centred = jax.lax.stop_gradient(points - jnp.mean(points, axis=0))
    return jnp.matmul(centred.T, centred, precision="highest") / points.shape[0]


def find_half_turns(covariance: chex.Array) -> chex.Array:
    """Half turns about the principal axes of a covariance [3, 3].

    Returns:
      [4, 4] quaternions: the identity, then 180° about each principal axis.
    """
    _, axes = jnp.linalg.eigh(covariance)
    turns = jnp.concatenate([jnp.zeros((3, 1), axes.dtype), axes.T], axis=1)
    return jnp.concatenate([jnp.array([quaternion.IDENTITY], axes.dtype), turns])


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


def compute_candidate_losses(
    points: chex.Array,
    mass: chex.Array,
    candidates: chex.Array,
    target: chex.Array,
    *,
    sigma: chex.Array,
    camera: Camera,
    at_once: int = 1,
) -> chex.Array:
    """Reprojection loss of each candidate, the inside of Eq. 2.

    Args:
      points: [N, 3]. mass: (), of each, in voxels.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), in voxels.
      at_once: how many candidates are rendered side by side, see `map_renders`.

    Returns:
      [C].
    """
    grid = VoxelGrid(target.shape[0])

    def compute_loss(candidate):
        image = project(
            points, candidate, sigma=sigma, scale=mass, camera=camera, grid=grid
        )
        return reprojection_loss(image.silhouette, target)

    return map_renders(compute_loss, candidates, at_once=at_once)


def choose_candidate(
    points: chex.Array,
    mass: chex.Array,
    candidates: chex.Array,
    target: chex.Array,
    *,
    sigma: chex.Array,
    camera: Camera,
    first_grid: int = 0,
    first_points: int = 0,
    top: int = 0,
    at_once: int = 1,
) -> chex.Array:
    """Index of the candidate whose silhouette fits one view best (Eq. 2); ().

    By default the exact minimum. With `first_grid` or `first_points`, candidates are
    first compared in a coarser volume and with fewer points, and of those only the best
    `top` exactly (0: the first comparison decides).

    Args:
      points: [N, 3]. mass: (), of each, in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), in voxels of the target's grid. camera: see `project`.
      first_grid: side of the coarser volume, a divisor of D; 0 for D.
      first_points: largest number of points of the first comparison; 0 for all.
      top: how many candidates are compared exactly after that.
      at_once: how many are rendered side by side: 1 on a CPU, 0 (all) on a GPU.

    Raises:
      ValueError: for a wrong shape, dtype or number.
    """
    points = checks.check_array("points", points, (None, 3))
    candidates = checks.check_array("candidates", candidates, (None, 4))
    target = checks.check_array("target", target, (None, None))
    side = target.shape[0]
    counts = {"first_grid": first_grid, "first_points": first_points, "top": top}
    for name, count in (counts | {"at_once": at_once}).items():
        checks.check_count(name, count)
    if not (len(points) and len(candidates) and side and target.shape == (side, side)):
        raise ValueError(
            "choose_candidate needs at least one point, one candidate and a square "
            f"target, but it got {len(points)} points, {len(candidates)} candidates "
            f"and a target of shape {list(target.shape)}; give some of each."
        )
    if first_grid and side % first_grid:
        raise ValueError(
            f"first_grid must divide the target's side {side}, but it is {first_grid}; "
            "give for example half of the side."
        )
    coarse_side = first_grid or side
    count = min(first_points or points.shape[0], points.shape[0])
    ratio = coarse_side / side
    factor = side // coarse_side
    blocks = target.reshape(coarse_side, factor, coarse_side, factor)
    losses = compute_candidate_losses(
        points[:count],
        mass * (points.shape[0] / count) * ratio**3,  # the same total mass
        candidates,
        jnp.mean(blocks, axis=(1, 3)),
        sigma=sigma * ratio,
        camera=camera,
        at_once=at_once,
    )
    is_exact = coarse_side == side and count == points.shape[0]
    if is_exact or top == 0:
        return jnp.argmin(losses)
    _, best = jax.lax.top_k(-losses, min(top, losses.shape[0]))
    exact = compute_candidate_losses(
        points,
        mass,
        candidates[best],
        target,
        sigma=sigma,
        camera=camera,
        at_once=at_once,
    )
    return best[jnp.argmin(exact)]
