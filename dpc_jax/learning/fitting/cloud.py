"""A cloud and the cameras of its views as they are learned, and what they look like."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.shapes.kind import View, sum_views
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import Weights
from dpc_jax.render import Camera

# By its gradient shapes and poses are better than by the trilinear one (docs/log.md).
METHOD = "quadratic"
BASE_SIDE = 32  # of the grid that masses are in; a finer one has them in its own voxels
_POINTS = 2000  # that a mass of one voxel each is right for


class Cloud(NamedTuple):
    """What is fitted; None where it is not there.

    Attributes:
      points: [N, 3] object frame.
      log_mass: (), of all points together, in 2000 voxels of the base grid.
      color_logits: [N, 3], of colours in [0, 1].
      rotations: [V, 4] quaternions of unit length.
      translations: [V, 3], object to camera.
      log_focal: [V], of the focal lengths over the camera's.
    """

    points: jax.Array
    log_mass: jax.Array
    color_logits: jax.Array | None
    rotations: jax.Array
    translations: jax.Array | None
    log_focal: jax.Array | None

    @property
    def colors(self) -> jax.Array | None:
        """[N, 3] in [0, 1]."""
        return None if self.color_logits is None else jax.nn.sigmoid(self.color_logits)

    def find_mass(self, side: int) -> jax.Array:
        """() of each point, in voxels of a grid of that side."""
        share = _POINTS / self.points.shape[0] * (side / BASE_SIDE) ** 3
        return jnp.exp(self.log_mass) * share

    def list_views(self, camera: Camera) -> dict[str, jax.Array]:
        """What each view has of its own, by name, [V, ...]."""
        views: dict[str, Any] = {"rotation": self.rotations}
        if self.translations is not None:
            views["translation"] = self.translations
        if self.log_focal is not None:
            views["focal_length"] = camera.focal_length * jnp.exp(self.log_focal)
        return views


def make_shell(key: jax.Array, count: int) -> jax.Array:
    """Points [count, 3], uniform on a sphere of radius 0.45 about the origin.

    From outside, points sink until silhouettes hold them up: they end on the surface.
    """
    away = jax.random.normal(key, (count, 3))
    return 0.45 * away / jnp.linalg.norm(away, axis=1, keepdims=True)


def split_points(cloud: Cloud, key: jax.Array, *, parts: int, distance: float) -> Cloud:
    """So many points for each, in random directions, so far away in the mean."""
    points = jnp.repeat(cloud.points, parts, axis=0)
    away = distance / jnp.sqrt(3) * jax.random.normal(key, points.shape)
    logits = cloud.color_logits
    if logits is not None:
        logits = jnp.repeat(logits, parts, axis=0)
    return cloud._replace(points=points + away, color_logits=logits)


def compare_views(
    cloud: Cloud,
    targets: Mapping[str, jax.Array],
    *,
    sigma: jax.Array,
    weights: Weights,
    camera: Camera,
    chosen: jax.Array | None = None,
    max_blocks: int | None = None,
) -> jax.Array:
    """Mean loss of all views, or of the chosen, per pixel of the targets (Eq. 1)."""
    side = targets["silhouette"].shape[-1]
    views, images = take_views((cloud.list_views(camera), dict(targets)), chosen)
    count = len(views["rotation"])
    one = {"points": cloud.points, "mass": cloud.find_mass(side)}
    if cloud.colors is not None:
        one["colors"] = cloud.colors
    scene = jax.tree.map(lambda a: jnp.broadcast_to(a, (count, *a.shape)), one)
    sigma = jax.lax.stop_gradient(jnp.broadcast_to(sigma, count))
    given = {"images": images, "sigma": sigma}

    def compare(learned, given):
        own = learned["view"]
        view = View(
            own["rotation"],
            place_camera(camera, own),
            side,
            own.get("translation"),
            max_blocks=max_blocks,
            method=METHOD,
        )
        scene = learned["scene"] | {"sigma": given["sigma"]}
        return Points.compare_view(scene, view, given["images"], weights=weights)

    found: Any = sum_views(compare, None, {"scene": scene, "view": views}, given)
    return found[0] / (count * side**2)


def take_views(entries: Any, chosen: jax.Array | None) -> Any:
    """The chosen of views' entries [V, ...]; all where none are."""
    if chosen is None:
        return entries
    return jax.tree.map(lambda array: array[chosen], entries)
