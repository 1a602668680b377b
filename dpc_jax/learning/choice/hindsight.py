"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
compared without gradient, and only the winner is rendered again with one.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.renders import compute_candidate_losses
from dpc_jax.learning.shapes.kind import Choice, Scene, Shape, View
from dpc_jax.learning.shapes.points import Points
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
    choice_points: int = 0,
    choice_top: int = 0,
    renders_at_once: int = AUTOMATIC,
) -> jax.Array:
    """Eq. 2 for one view: index of the candidate with the smallest loss; ().

    By default the exact minimum. With `choice_points`, candidates are first ranked by
    the optical depth that so many points have in each pixel, without a volume; then the
    best `choice_top` are compared exactly, or with 0 the first of the ranking stands.

    Args:
      points: [N, 3], object frame.
      mass: () of each point, or [N], in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      sigma: (), or [N] of each point, in voxels of the target's grid, or covariances
        [N, 3, 3] in voxels² (`project` has them as covariance).
      camera: see `project`.
      choice_points: largest number of points of the ranking; 0: there is none.
      choice_top: how many candidates are then compared exactly.
      renders_at_once: how many are rendered side by side, 0 for all; -1 takes one on a
        CPU and all on a GPU.

    Raises:
      ValueError: for a wrong shape, dtype or number.
    """
    points = checks.check_array("points", points, (None, 3))
    candidates = checks.check_array("candidates", candidates, (None, 4))
    target = checks.check_array("target", target, (None, None))
    side = target.shape[0]
    checks.check_count("choice_points", choice_points)
    checks.check_count("choice_top", choice_top)
    check_renders_at_once(renders_at_once)
    if not (len(points) and len(candidates) and side and target.shape == (side, side)):
        raise ValueError(
            "choose_candidate needs at least one point, one candidate and a square "
            f"target, but it got {len(points)} points, {len(candidates)} candidates "
            f"and a target of shape {list(target.shape)}; give at least one of each."
        )
    how = Choice(choice_points, choice_top, renders_at_once)
    scene = {"points": points, "mass": mass, "sigma": sigma}
    places = place_in_image(
        Points, scene, candidates, {}, side=side, camera=camera, how=how
    )
    return choose_in_scene(
        Points, scene, candidates, target, places, {}, camera=camera, how=how
    )


def choose_in_scene(
    kind: type[Shape],
    scene: Scene,
    candidates: jax.Array,
    target: jax.Array,
    places: Any,
    own: Mapping[str, Any],
    *,
    camera: Camera,
    how: Choice,
) -> jax.Array:
    """Eq. 2 for one view of checked arguments: index of the best candidate; ().

    Args:
      kind, scene: of one object.
      candidates: [C, 4] quaternions. target: [D, D] silhouette.
      places: of `place_in_image`. They come from outside of the loop over views:
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
    coarse = kind.rank(scene, candidates, target, places, how=how, **view)
    if coarse is None:
        losses = compute_candidate_losses(kind, scene, candidates, target, **exactly)
        return jnp.argmin(losses)
    if how.top == 0:
        return jnp.argmin(coarse)
    _, best = jax.lax.top_k(-coarse, min(how.top, len(candidates)))
    losses = compute_candidate_losses(kind, scene, candidates[best], target, **exactly)
    return best[jnp.argmin(losses)]


def place_in_image(
    kind: type[Shape],
    scene: Scene,
    candidates: jax.Array,
    own: Mapping[str, Any],
    *,
    side: int,
    camera: Camera,
    how: Choice,
) -> Any:
    """`Shape.place_in_image` of a view with what it has of its own."""
    view = View(candidates[0], place_camera(camera, own), side, own.get("translation"))
    return kind.place_in_image(scene, candidates, view, how)
