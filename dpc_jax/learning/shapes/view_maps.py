"""EPCG in the objective: maps beside their own views, and what their points show.

After the first stage of Lin et al. (AAAI 2018). Coordinates learn from depths, logits
from masks. docs/baselines.md says what differs from their code.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning.shapes.kind import Shape
from dpc_jax.learning.signals import LOSSES, find_background, make_targets
from dpc_jax.networks.view_maps import make_planes
from dpc_jax.render import Projection
from dpc_jax.render.camera import to_camera_frame

SAMPLES = 10_000  # points of a prediction, as many as of surfaces of voxel models
_NEAREST = 0.1  # depth, in box diagonals, nearer than which no point is drawn


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ViewMaps(Shape):
    """Predicted maps of B objects.

    A scene has points [N, 3] and their point_logits [N].

    Attributes:
      maps: [B, 8, S, S, 3], see `ViewMapHead`.
      points: [B, N, 3], theirs in the object frame.
      logits: [B, N], above 0 of visible points.
    """

    maps: jax.Array
    points: jax.Array
    logits: jax.Array

    def find_scale(self):
        """Share of visible points, recorded where points have their scale."""
        return jnp.mean(self.logits > 0, axis=1)

    @classmethod
    def read(cls, output, sigma, *, render):
        return cls(output["maps"], output["points"], output["point_logits"])

    def list_scenes(self, ratio=1.0):
        return {"points": self.points, "point_logits": self.logits}, {}

    def compare(self, views, batch, *, recipe, stage):
        """Each map against its own fixed view; mean over objects and views.

        Cross entropy of the masks, absolute differences of u and v from the pixel's
        place, and of depth where the object covers at least half of the pixel.

        Args:
          batch: corner_masks uint8 and corner_depths [B, 8, S, S] of the fixed views.
        """
        weights, distance = recipe.weights, recipe.render.distance
        corners = {"masks": batch["corner_masks"], "depths": batch["corner_depths"]}
        side = self.maps.shape[-2]
        signals = ("silhouette", "depth")
        targets = make_targets(corners, side, signals=signals, distance=distance)
        count = self.maps.shape[0] * self.maps.shape[1]
        logits = self.logits.reshape(targets["silhouette"].shape)
        # In nats; masks are shares of pixels.
        entropy = optax.losses.sigmoid_binary_cross_entropy
        masks = jnp.sum(entropy(logits, targets["silhouette"])) / count
        plane = make_planes(side, 0.0)[None, None, ..., :2]
        deviation = jnp.sum(jnp.abs(self.maps[..., :2] - plane)) / count
        terms = {LOSSES["silhouette"]: masks, "pixel_deviation": deviation}
        total = weights.silhouette * masks + deviation
        if weights.depth:
            background, measured = find_background(distance), targets["measured"]
            is_known = measured >= 0.5
            nearer = targets["depth"] - background  # times the share that is measured
            depths = background + nearer / jnp.where(is_known, measured, 1)
            away = jnp.where(is_known, jnp.abs(self.maps[..., 2] - depths), 0)
            terms[LOSSES["depth"]] = jnp.sum(away) / count
            total += weights.depth * terms[LOSSES["depth"]]
        return total, terms, None

    @staticmethod
    def find_evaluated(output, scene):
        """Visible points, spread evenly over all of them."""
        points, logits = output["points"], output["point_logits"]
        choose = functools.partial(choose_visible, count=min(SAMPLES, points.shape[1]))
        return {"points": jax.vmap(choose)(points, logits)}

    @classmethod
    def render(cls, scene, view, *, signals, background_depth=10.0):
        """Pixels of visible points are covered, as far away as the nearest of them."""
        camera, side = view.camera, view.side
        moved = to_camera_frame(scene["points"], view.rotation, view.translation)
        depths = camera.find_depths(moved)
        is_seen = (scene["point_logits"] > 0) & (depths > _NEAREST)
        zoom = camera.focal_length / jnp.where(is_seen, depths, 1)
        columns, rows = jnp.floor((zoom[None] * moved[:, :2].T + 0.5) * side)
        is_seen &= (columns >= 0) & (columns < side) & (rows >= 0) & (rows < side)
        # Points outside are given a pixel beyond the last, and dropped.
        pixels = jnp.where(is_seen, rows * side + columns, side**2).astype(jnp.int32)
        nearest = jnp.full(side**2, jnp.inf).at[pixels].min(depths, mode="drop")
        nearest = nearest.reshape(side, side)
        is_covered = jnp.isfinite(nearest)
        images = {
            "silhouette": is_covered.astype(depths.dtype),
            "depth": jnp.where(is_covered, nearest, background_depth),
        }
        return Projection(**images)


def choose_visible(points: jax.Array, logits: jax.Array, *, count: int) -> jax.Array:
    """`count` points [count, 3] of the visible ones, spread evenly over their order.

    Fewer visible points come several times; where there is none, the one of the top
    logit does.

    Args:
      points: [N, 3]. logits: [N], above 0 of visible points.
    """
    is_visible = logits > 0
    is_visible = is_visible | ~jnp.any(is_visible) & (logits == jnp.max(logits))
    places = jnp.cumsum(is_visible)  # 1 at the first visible point
    total = places[-1]
    # Visible points wanted, from 1 on; in float32 exact for up to 2²⁴ of them.
    wanted = jnp.floor(jnp.arange(count) * (total / count)).astype(jnp.int32) + 1
    return points[jnp.searchsorted(places, jnp.minimum(wanted, total))]
