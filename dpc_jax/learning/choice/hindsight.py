"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
compared without gradient, and only the winner is rendered again with one.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import CHOICE_RANKS
from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.choice.coarse_choice import (
    ImagePoints,
    compute_coarse_losses,
    compute_image_losses,
    place_candidates,
    shrink_target,
)
from dpc_jax.learning.renders import Scene, compute_candidate_losses
from dpc_jax.learning.signals import SILHOUETTES, Weights
from dpc_jax.render import Camera, checks
from dpc_jax.render.batch import check_renders_at_once
from dpc_jax.render.devices import AUTOMATIC


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
    (docs/log.md).

    Args:
      points: [N, 3], object frame.
      mass: () of each point, or [N], in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), or [N] of each point, in voxels of the target's grid, or covariances
        [N, 3, 3] in voxels² (`project` has them as covariance).
      camera: see `project`.
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
    how = Choice(choice_rank, choice_grid, choice_points, choice_top, renders_at_once)
    scene = {"points": points, "mass": mass, "sigma": sigma}
    places = find_image_places(scene, candidates, {}, side=side, camera=camera, how=how)
    return choose_in_scene(
        scene, candidates, target, places, {}, camera=camera, how=how
    )


class Choice(NamedTuple):
    """How candidates are compared; static.

    Attributes:
      rank, grid, points, top, renders_at_once: as of `choose_candidate`.
      weights, ray_rule: of the comparison at full resolution.
    """

    rank: str
    grid: int
    points: int
    top: int
    renders_at_once: int
    weights: Weights = SILHOUETTES
    ray_rule: str = "termination"

    @property
    def is_exact(self) -> bool:
        """Whether all candidates are compared at full resolution at once."""
        return self.grid == self.points == 0


def find_image_places(
    scene: Scene,
    candidates: jax.Array,
    own: Mapping[str, Any],
    *,
    side: int,
    camera: Camera,
    how: Choice,
) -> ImagePoints | None:
    """Points in the image of each candidate; None where no image ranks them.

    Args:
      scene, candidates, own: of one view, see `choose_in_scene`.
      side: of the target, in pixels.
    """
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


def choose_in_scene(
    scene: Scene,
    candidates: jax.Array,
    target: jax.Array,
    places: ImagePoints | None,
    own: Mapping[str, Any],
    *,
    camera: Camera,
    how: Choice,
) -> jax.Array:
    """Eq. 2 for one view of checked arguments: index of the best candidate; ().

    Args:
      scene: of one object, see `renders`.
      candidates: [C, 4] quaternions. target: [D, D] silhouette.
      places: of `find_image_places`. They come from outside of the loop over views:
        inside, XLA projects each point again for every pixel.
      own: what the view has of its own, see `list_own`; for signals other than the
        silhouette "others", their targets.
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
