"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
compared without gradient, and only the winner is rendered again with one.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import CHOICE_RANKS, Pose, Render
from dpc_jax.learning.coarse_choice import (
    compute_coarse_losses,
    compute_image_losses,
    place_candidates,
)
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.point_sizes import has_own_sizes
from dpc_jax.learning.predictions import Shapes
from dpc_jax.learning.renders import compute_candidate_losses
from dpc_jax.render import Camera, checks
from dpc_jax.render.batch import check_renders_at_once, map_renders
from dpc_jax.render.devices import AUTOMATIC


class Winners(NamedTuple):
    """The candidates that explain the views of a batch best.

    Attributes:
      poses: [B, V, 4] quaternions.
      indices: [B, V] int32; candidate i belongs to head i % K.
    """

    poses: jax.Array
    indices: jax.Array


def choose_candidate(
    points: jax.Array,
    mass: jax.Array,
    candidates: jax.Array,
    target: jax.Array,
    *,
    sigma: jax.Array,
    camera: Camera,
    choice_grid: int = 0,
    choice_points: int = 0,
    choice_top: int = 0,
    choice_rank: str = "volume",
    renders_at_once: int = AUTOMATIC,
) -> jax.Array:
    """Eq. 2 for one view: index of the candidate with the smallest loss; ().

    By default the exact minimum. With `choice_grid` or `choice_points`, candidates are
    ranked in a coarser volume and with fewer points, then the best `choice_top` are
    compared at full resolution; with 0 the coarse winner stands. With `choice_rank`
    "image" they are ranked by the optical depth of each pixel, without a volume:
    several times faster and, at the same resolution, at least as often right
    (docs/profile.md).

    Args:
      points: [N, 3]. mass: () of each point, or [N], in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), or [N] of each point, in voxels of the target's grid, or covariances
        [N, 3, 3] in voxels² (`project` has them as covariance). camera: see `project`.
      choice_grid: side of the coarser volume or image, a divisor of D; 0 for D.
      choice_points: largest number of points of the first comparison; 0 for all.
      choice_top: how many candidates are then compared at full resolution.
      choice_rank: "volume" or "image", what candidates are ranked in first.
      renders_at_once: how many are rendered side by side, 0 for all; -1 takes one on a
        CPU and all on a GPU.

    Raises:
      ValueError: for a wrong shape, dtype or number.
    """
    points = checks.check_array("points", points, (None, 3))
    candidates = checks.check_array("candidates", candidates, (None, 4))
    target = checks.check_array("target", target, (None, None))
    side = target.shape[0]
    counts = {
        "choice_grid": choice_grid,
        "choice_points": choice_points,
        "choice_top": choice_top,
    }
    for name, count in counts.items():
        checks.check_count(name, count)
    check_renders_at_once(renders_at_once)
    if not (len(points) and len(candidates) and side and target.shape == (side, side)):
        raise ValueError(
            "choose_candidate needs at least one point, one candidate and a square "
            f"target, but it got {len(points)} points, {len(candidates)} candidates "
            f"and a target of shape {list(target.shape)}; give at least one of each."
        )
    checks.check_choice("choice_rank", choice_rank, CHOICE_RANKS, "choose one of these")
    how = _Choice(choice_rank, choice_grid, choice_points, choice_top, renders_at_once)
    places = _place_points(points, candidates, sigma, side, camera, how)
    return _choose(
        points, mass, candidates, target, places, sigma, camera=camera, how=how
    )


class _Choice(NamedTuple):
    """How candidates are compared; static."""

    rank: str
    grid: int
    points: int
    top: int
    renders_at_once: int

    @property
    def is_exact(self):
        """Whether all candidates are compared at full resolution at once."""
        return self.grid == self.points == 0


def _place_points(points, candidates, sigma, side, camera, how):
    """Points in the image of each candidate, where they are ranked by an image."""
    if how.rank != "image" or how.is_exact:
        return None
    return place_candidates(
        points,
        candidates,
        side=how.grid or side,
        camera=camera,
        choice_points=how.points,
        size=sigma,
    )


def _choose(points, mass, candidates, target, places, sigma, *, camera, how):
    """`choose_candidate` of checked arguments; places of `_place_points`."""
    arguments = points, mass, candidates, target
    view = {
        "sigma": sigma,
        "camera": camera,
        "renders_at_once": how.renders_at_once,
    }
    has_all_points = min(how.points or len(points), len(points)) == len(points)
    has_all_cells = how.grid in (0, target.shape[0])
    if how.is_exact or how.rank == "volume" and has_all_cells and has_all_points:
        return jnp.argmin(compute_candidate_losses(*arguments, **view))
    if places is not None:
        coarse = compute_image_losses(
            places, mass, target, sigma=sigma, choice_grid=how.grid
        )
    else:
        coarse = compute_coarse_losses(
            *arguments, choice_grid=how.grid, choice_points=how.points, **view
        )
    if how.top == 0:
        return jnp.argmin(coarse)
    _, best = jax.lax.top_k(-coarse, min(how.top, len(candidates)))
    losses = compute_candidate_losses(points, mass, candidates[best], target, **view)
    return best[jnp.argmin(losses)]


def choose_poses(
    shapes: Shapes,
    candidates: jax.Array,
    masks: jax.Array,
    *,
    camera: Camera,
    render: Render,
    pose: Pose,
) -> Winners:
    """Eq. 2 for all views of a batch, without gradient.

    Args:
      shapes: of B objects.
      candidates: [B·V, C, 4] quaternions.
      masks: uint8 [B, V, S, S].
      camera: see `project`.
      render: the grid, and how many renders run side by side. pose: how candidates
        are compared.
    """
    batch_size, views = masks.shape[:2]
    candidates = candidates.reshape(batch_size, views, -1, 4)
    if candidates.shape[2] == 1:
        return Winners(candidates[:, :, 0], jnp.zeros((batch_size, views), jnp.int32))

    how = _Choice(
        pose.choice_rank,
        pose.choice_grid,
        pose.choice_points,
        pose.choice_top,
        render.renders_at_once,
    )
    shapes, still = jax.lax.stop_gradient((shapes, candidates))
    points = jnp.repeat(shapes.kept, views, axis=0)
    flat = still.reshape(batch_size * views, -1, 4)
    has_sizes = has_own_sizes(shapes.sigma)
    sigma = jnp.repeat(shapes.sigma, views, axis=0) if has_sizes else shapes.sigma
    places = jax.vmap(
        lambda points, candidates, sigma: _place_points(
            points, candidates, sigma, render.grid, camera, how
        ),
        (0, 0, 0 if has_sizes else None),
    )(points, flat, sigma)
    targets = downsample_images(masks, render.grid)
    inputs = (
        points,
        jnp.repeat(shapes.mass, views, axis=0),
        flat,
        targets.reshape(batch_size * views, *targets.shape[2:]),
        places,
        sigma if has_sizes else None,
    )

    def choose(view):
        *arrays, own = view
        arrays.append(shapes.sigma if own is None else own)
        return _choose(*arrays, camera=camera, how=how)

    indices = map_renders(
        choose,
        inputs,
        renders_at_once=render.renders_at_once,
    ).reshape(batch_size, views)
    poses = jnp.take_along_axis(candidates, indices[..., None, None], axis=2)[:, :, 0]
    return Winners(poses, indices)
