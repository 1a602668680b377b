"""The hindsight choice: which pose candidate explains a view best (Eq. 2).

The minimum over candidates has the gradient of its winner. So all candidates are
compared without gradient, and only the winner is rendered again with one.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.candidates import turn_index
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.shapes.kind import Choice, Scene, Shape, View, place_view
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import make_targets
from dpc_jax.render import Camera, checks, quaternion
from dpc_jax.render.batch import map_renders

# Among the first of a cloud: the winner is one of the three best of such a ranking in
# 0.99 of the views.
RANKING_POINTS = 250


class Winners(NamedTuple):
    """The candidates that explain the views of a batch best.

    Attributes:
      poses: [n, 4] quaternions.
      indices: [n] int32; candidate i belongs to head i % K.
      losses: [n, C] of all candidates, infinite of those that are ranked too low to
        be compared exactly; None where none are.
    """

    poses: jax.Array
    indices: jax.Array
    losses: jax.Array | None = None

    def turn(self, turns: jax.Array, chosen: jax.Array, *, heads: int) -> "Winners":
        """After the chosen [n] of the half turns [T, 4] of the objects; of K heads."""
        poses = jax.vmap(quaternion.multiply)(self.poses, turns[chosen])
        return Winners(poses, turn_index(self.indices, chosen, heads))


def choose_poses(
    shapes: Shape,
    candidates: jax.Array,
    batch: Mapping[str, jax.Array],
    cameras: Cameras,
    *,
    recipe: Recipe,
) -> Winners:
    """Eq. 2 for all n views of a batch, without gradient.

    Args:
      shapes: one for each view. candidates: [n, C, 4] quaternions.
      batch: masks uint8 [n, S, S] and, as the signals need them by which candidates are
        compared at full resolution, images and depths: see `make_targets`.
      cameras: of the views.
    """
    if candidates.shape[1] == 1:
        return Winners(candidates[:, 0], jnp.zeros(len(candidates), jnp.int32))

    pose, render = recipe.pose, recipe.render
    weights = recipe.weights._replace(background=0)  # silhouettes by their squares
    at_once = render.renders_at_once
    is_ranked = 0 < pose.choice_top < candidates.shape[1]
    how = Choice(RANKING_POINTS * is_ranked, pose.choice_top, at_once, weights)
    shapes, still, cameras = jax.lax.stop_gradient((shapes, candidates, cameras))
    kind = type(shapes)
    scene, shared = shapes.list_scenes()
    if "color" not in weights.signals:
        scene.pop("colors", None)

    def compare(inputs):
        scene, candidates, targets, per_view = inputs
        view = place_view(candidates, per_view, render.grid, render)
        return compare_in_scene(kind, scene | shared, view, targets, how)

    targets = make_targets(
        batch,
        render.grid,
        signals=("silhouette", *weights.signals),
        distance=render.distance,
        spreads_masks=weights.spreads_masks,
    )
    found = map_renders(
        compare,
        (scene, still, targets, cameras),
        renders_at_once=at_once,
    )
    indices = jnp.argmin(found, axis=-1)
    poses = jnp.take_along_axis(candidates, indices[:, None, None], axis=1)[:, 0]
    return Winners(poses, indices, found)


def compare_in_scene(
    kind: type[Shape],
    scene: Scene,
    view: View,
    targets: Mapping[str, jax.Array],
    how: Choice,
) -> jax.Array:
    """Losses [C] of a view of checked arguments; infinite of what is ranked too low."""
    coarse = kind.rank(scene, view, targets["silhouette"], how)
    if coarse is None:
        return kind.compare_candidates(scene, view, targets, how)
    if how.top == 0:
        return coarse
    _, best = jax.lax.top_k(-coarse, min(how.top, len(view.rotation)))
    view = view._replace(rotation=view.rotation[best])
    exact = kind.compare_candidates(scene, view, targets, how)
    return jnp.full_like(coarse, jnp.inf).at[best].set(exact)


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
    renders_at_once: int | None = None,
) -> jax.Array:
    """Eq. 2 for one view: index of the candidate with the smallest loss; ().

    By default the exact minimum. With `choice_points`, candidates are first ranked by
    the optical depth that so many points have in each pixel, without a volume; then the
    best `choice_top` are compared exactly, or with 0 the first of the ranking stands.
    Where points differ in mass or size, none is ranked and all are compared exactly.

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
      renders_at_once: how many are rendered side by side; None takes one on a CPU and
        all on a GPU.

    Returns:
      () int32.

    Raises:
      ValueError: for a wrong shape, dtype or number.

    Example:
      >>> cloud, poses = jnp.array([[0.1, 0.2, 0.0]]), jnp.eye(4)[:2]
      >>> target = dpc_jax.project(cloud, poses[1], sigma=1.0).silhouette
      >>> sizes = {"mass": jnp.ones(()), "sigma": jnp.ones(())}
      >>> view = {"candidates": poses, "target": target, "camera": dpc_jax.Camera()}
      >>> int(dpc_jax.choose_candidate(cloud, **sizes, **view))
      1
    """
    points = checks.check_array("points", points, (None, 3))
    candidates = checks.check_array("candidates", candidates, (None, 4))
    target = checks.check_array("target", target, (None, None))
    side = target.shape[0]
    checks.check_count("choice_points", choice_points)
    checks.check_count("choice_top", choice_top)
    if renders_at_once is not None:
        checks.check_count("renders_at_once", renders_at_once, least=1)
    if not (len(points) and len(candidates) and side and target.shape == (side, side)):
        raise ValueError(
            "choose_candidate needs at least one point, one candidate and a square "
            f"target, but it got {len(points)} points, {len(candidates)} candidates "
            f"and a target of shape {list(target.shape)}; give at least one of each."
        )
    how = Choice(choice_points, choice_top, renders_at_once)
    scene = {"points": points, "mass": mass, "sigma": sigma}
    view = View(candidates, camera, side)
    targets = {"silhouette": target}
    return jnp.argmin(compare_in_scene(Points, scene, view, targets, how))
