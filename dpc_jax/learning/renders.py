"""Losses of pose candidates, by what a scene looks like from each."""

from collections.abc import Mapping

import jax

from dpc_jax.learning.shapes.kind import Scene, Shape, View
from dpc_jax.learning.signals import SILHOUETTES, Weights, compare_images
from dpc_jax.render import Camera
from dpc_jax.render.batch import map_renders
from dpc_jax.render.devices import AUTOMATIC


def compute_candidate_losses(
    kind: type[Shape],
    scene: Scene,
    candidates: jax.Array,
    target: jax.Array,
    *,
    camera: Camera,
    renders_at_once: int = AUTOMATIC,
    translation: jax.Array | None = None,
    others: Mapping[str, jax.Array] | None = None,
    weights: Weights = SILHOUETTES,
    ray_rule: str = "termination",
) -> jax.Array:
    """Loss of each pose candidate of one view, by its silhouette or by more signals.

    Args:
      kind, scene: with sizes in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      camera, ray_rule: see `project`.
      renders_at_once: how many candidates are rendered side by side, see `map_renders`.
      translation: [3] of the object in the camera frame.
      others: targets of other signals by name (`make_targets`), as the weights need
        them.
      weights: of the signals.

    Returns:
      [C].
    """
    targets = {"silhouette": target, **(others or {})}

    def compute_loss(candidate):
        view = View(candidate, camera, target.shape[0], translation, ray_rule)
        image = kind.render(scene, view, signals=weights.renders)
        return compare_images(image, targets, weights=weights, camera=camera)[0]

    return map_renders(compute_loss, candidates, renders_at_once=renders_at_once)
