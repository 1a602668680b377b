"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
compared without gradient, and only the winner is rendered again with one.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import CHOICE_RANKS, Pose, Render
from dpc_jax.learning.cameras import Cameras, list_own, place_camera
from dpc_jax.learning.choice.coarse_choice import (
    compute_coarse_losses,
    compute_image_losses,
    place_candidates,
    shrink_target,
)
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.predictions import Cells, Shapes
from dpc_jax.learning.renders import compute_candidate_losses, make_scenes
from dpc_jax.learning.signals import SILHOUETTES, Weights, make_targets
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
    scene = {"points": points, "mass": mass, "sigma": sigma}
    places = _place_points(scene, candidates, {}, side, camera, how)
    return _choose(scene, candidates, target, places, {}, camera=camera, how=how)


class _Choice(NamedTuple):
    """How candidates are compared; static."""

    rank: str
    grid: int
    points: int
    top: int
    renders_at_once: int
    weights: Weights = SILHOUETTES  # of the exact comparison
    ray_rule: str = "termination"

    @property
    def is_exact(self):
        """Whether all candidates are compared at full resolution at once."""
        return self.grid == self.points == 0


def _place_points(scene, candidates, own, side, camera, how):
    """Points in the image of each candidate, where they are ranked by an image."""
    if how.rank != "image" or how.is_exact or "cells" in scene:
        return None
    return place_candidates(
        scene["points"],
        candidates,
        side=how.grid or side,
        camera=place_camera(camera, own),
        choice_points=how.points,
        translation=own.get("translation"),
        size=scene["sigma"],
    )


def _choose(scene, candidates, target, places, own, *, camera, how):
    """`choose_candidate` of checked arguments; places of `_place_points`.

    `own` is what the view has of its own: see `list_own`; in an exact comparison of
    other signals than the silhouette "others", their targets.
    """
    view = {
        "camera": place_camera(camera, own),
        "renders_at_once": how.renders_at_once,
        "translation": own.get("translation"),
    }
    exactly = view | {"weights": how.weights, "ray_rule": how.ray_rule}
    exactly["others"] = own.get("others")
    if _is_exact(scene, target, how):
        losses = compute_candidate_losses(scene, candidates, target, **exactly)
        return jnp.argmin(losses)
    if "cells" in scene:
        # Volumes stay as they are, and are seen in a coarser grid.
        coarse = compute_candidate_losses(
            scene,
            candidates,
            shrink_target(target, how.grid),
            ray_rule=how.ray_rule,
            **view,
        )
    elif places is not None:
        coarse = compute_image_losses(
            places, scene["mass"], target, sigma=scene["sigma"], choice_grid=how.grid
        )
    else:
        coarse = compute_coarse_losses(
            scene,
            candidates,
            target,
            choice_grid=how.grid,
            choice_points=how.points,
            **view,
        )
    if how.top == 0:
        return jnp.argmin(coarse)
    _, best = jax.lax.top_k(-coarse, min(how.top, len(candidates)))
    losses = compute_candidate_losses(scene, candidates[best], target, **exactly)
    return best[jnp.argmin(losses)]


def _is_exact(scene, target, how):
    """Whether the first comparison is at full resolution already."""
    has_all_cells = how.grid in (0, target.shape[0])
    if "cells" in scene:
        return has_all_cells
    count = len(scene["points"])
    has_all_points = min(how.points or count, count) == count
    return how.is_exact or how.rank == "volume" and has_all_cells and has_all_points


def choose_poses(
    shapes: Shapes | Cells,
    candidates: jax.Array,
    masks: jax.Array,
    *,
    camera: Camera,
    render: Render,
    pose: Pose,
    cameras: Cameras = Cameras(),
    views: Mapping[str, jax.Array] | None = None,
    weights: Weights = SILHOUETTES,
) -> Winners:
    """Eq. 2 for all views of a batch, without gradient.

    Args:
      shapes: of B objects.
      candidates: [B·V, C, 4] quaternions.
      masks: uint8 [B, V, S, S].
      camera: see `project`.
      render: the grid, and how many renders run side by side. pose: how candidates
        are compared.
      cameras: [B, V, ...] of the views, where they have their own.
      views: masks and, as the weights need them, images and depths: see `make_targets`.
      weights: of the signals by which candidates are compared at full resolution, if
        `pose.choice_signals` is "all"; the silhouette alone otherwise.
    """
    batch_size, per_object = masks.shape[:2]
    total = batch_size * per_object
    candidates = candidates.reshape(batch_size, per_object, -1, 4)
    if candidates.shape[2] == 1:
        indices = jnp.zeros((batch_size, per_object), jnp.int32)
        return Winners(candidates[:, :, 0], indices)

    if pose.choice_signals == "silhouette":
        weights = SILHOUETTES
    how = _Choice(
        pose.choice_rank,
        pose.choice_grid,
        pose.choice_points,
        pose.choice_top,
        render.renders_at_once,
        weights,
        render.ray_rule,
    )
    shapes, still, cameras = jax.lax.stop_gradient((shapes, candidates, cameras))
    scene, shared = make_scenes(shapes)
    if "color" not in weights.signals:
        scene.pop("colors", None)
    scene = {n: jnp.repeat(a, per_object, axis=0) for n, a in scene.items()}
    flat = still.reshape(total, -1, 4)
    own = list_own(cameras, total)
    places = jax.vmap(
        lambda scene, candidates, own: _place_points(
            scene | shared, candidates, own, render.grid, camera, how
        )
    )(scene, flat, own)
    targets = downsample_images(masks, render.grid)
    own |= _list_others(views or {}, render, weights)
    targets = targets.reshape(total, *targets.shape[2:])

    def choose(view):
        scene, *rest = view
        return _choose(scene | shared, *rest, camera=camera, how=how)

    indices = map_renders(
        choose,
        (scene, flat, targets, places, own),
        renders_at_once=render.renders_at_once,
    ).reshape(batch_size, per_object)
    poses = jnp.take_along_axis(candidates, indices[..., None, None], axis=2)[:, :, 0]
    return Winners(poses, indices)


def _list_others(views, render, weights):
    """Targets of the signals besides silhouettes."""
    names = tuple(name for name in weights.signals if name != "silhouette")
    if not names:
        return {}
    targets = make_targets(views, render.grid, signals=names, distance=render.distance)
    return {"others": {n: a.reshape(-1, *a.shape[2:]) for n, a in targets.items()}}
