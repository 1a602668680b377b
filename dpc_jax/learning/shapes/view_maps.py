"""EPCG in the objective: pseudo-renders of fused maps, and the maps' own views.

After Lin et al. (AAAI 2018). A pseudo-render has no gradient towards where in the image
a point lies: pixels are whole numbers. Coordinates learn from depths, logits from
masks. docs/baselines.md says what differs from their code.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import optax

from dpc_jax.config import Render
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes.kind import Scene, Shape, View
from dpc_jax.learning.signals import LOSSES, Weights, find_background, make_targets
from dpc_jax.networks.view_maps import make_planes
from dpc_jax.render import Projection, quaternion

FINER = 5  # cells of the pseudo-render along a pixel's side
SAMPLES = 10_000  # points of a prediction, as many as of surfaces of voxel models
_NEAREST = 0.1  # depth, in box diagonals, nearer than which no point is drawn
_NO_POINT = -1.0  # logit of a pixel that no point falls into


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

    def find_scale(self) -> jax.Array:
        """Share of visible points, recorded where points have their scale."""
        return jnp.mean(self.logits > 0, axis=1)

    @classmethod
    def read(
        cls, output: Mapping[str, Any], sigma: jax.Array, *, render: Render
    ) -> Self:
        """Points of maps have no size to read."""
        del sigma, render
        return cls(output["maps"], output["points"], output["point_logits"])

    def list_scenes(self, ratio: float = 1.0) -> tuple[dict[str, Any], dict[str, Any]]:
        """The scenes of a batch, which are the same in every grid."""
        del ratio
        return {"points": self.points, "point_logits": self.logits}, {}

    def compare(
        self,
        rotations: jax.Array,
        batch: Mapping[str, jax.Array],
        cameras: Cameras,
        *,
        recipe: Recipe,
        stage: Stage,
    ) -> tuple[jax.Array, dict[str, jax.Array], jax.Array | None]:
        """Each map with its own view in the first stage, pseudo-renders after it."""
        if not stage.fixed_views:
            return super().compare(
                rotations, batch, cameras, recipe=recipe, stage=stage
            )
        return *compare_fixed_views(self, batch, recipe=recipe), None

    @staticmethod
    def find_evaluated(output: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
        """Visible points, spread evenly over all of them."""
        del scene
        points, logits = output["points"], output["point_logits"]
        choose = functools.partial(choose_visible, count=min(SAMPLES, points.shape[1]))
        return {"points": jax.vmap(choose)(points, logits)}

    @classmethod
    def render(
        cls,
        scene: Scene,
        view: View,
        *,
        signals: tuple[str, ...],
        background_depth: jax.Array | float = 10.0,
    ) -> Projection:
        """A pseudo-render as images: a pixel with a visible point is covered."""
        del signals
        drawn = pseudo_render(scene["points"], scene["point_logits"], view)
        silhouette = (drawn.counts > 0).astype(drawn.logits.dtype)
        depth = background_depth + silhouette * (drawn.depths - background_depth)
        images = {"silhouette": silhouette, "depth": depth}
        return Projection(**images)

    @classmethod
    def compare_view(
        cls,
        scene: Scene,
        view: View,
        targets: Mapping[str, jax.Array],
        *,
        weights: Weights,
        colors_move_shapes: bool = True,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """By the cross entropy of the mask, and by absolute differences of depth.

        The latter where the object covers at least half of the pixel and one point is
        nearest.
        """
        del colors_move_shapes  # there are none
        drawn = pseudo_render(scene["points"], scene["point_logits"], view)
        masks = _cross_entropy(drawn.logits, targets["silhouette"])
        total, terms = weights.silhouette * masks, {LOSSES["silhouette"]: masks}
        if weights.depth:
            depths, is_known = _read_depths(targets, view.camera.distance)
            is_compared = is_known & (drawn.counts == 1)
            away = jnp.abs(drawn.depths - jnp.where(is_known, depths, 0))
            terms[LOSSES["depth"]] = jnp.sum(jnp.where(is_compared, away, 0))
            total += weights.depth * terms[LOSSES["depth"]]
        return total, terms


class PseudoRender(NamedTuple):
    """What a view sees of a fused cloud.

    Attributes:
      logits: [S, S], above 0 where there is a surface.
      depths: [S, S], metric z of the nearest visible point; where none is, 1.
      counts: [S, S], most visible points in one of a pixel's cells. A depth can be
        trusted where this is 1: two points in a cell have their inverse depths added.
    """

    logits: jax.Array
    depths: jax.Array
    counts: jax.Array


def pseudo_render(points: jax.Array, logits: jax.Array, view: View) -> PseudoRender:
    """Points [N, 3] of logits [N], drawn into cells of a fifth of a pixel.

    Of each pixel's cells the nearest inverse depth, the top logit and the largest count
    are kept, each on its own. Points that are not visible (logit below 0) are averaged,
    where no visible one is.
    """
    camera, side = view.camera, view.side
    seen = quaternion.rotate(points, view.rotation)
    if view.translation is not None:
        seen = seen + view.translation[None]
    depth = seen[:, 2] + camera.distance
    is_before = depth > _NEAREST
    depth = jnp.where(is_before, depth, 1)
    plane = camera.focal_length * seen[:, :2] / depth[:, None]
    size = side * FINER
    columns, rows = jnp.floor((plane.T + 0.5) * size)
    is_inside = is_before & (columns >= 0) & (columns < size)
    is_inside &= (rows >= 0) & (rows < size)
    # Points outside are given a cell beyond the last, and dropped.
    cells = jnp.where(is_inside, rows * size + columns, size**2).astype(jnp.int32)
    is_visible = (logits > 0).astype(points.dtype)
    values = jnp.stack(
        [is_visible / depth, is_visible * logits, is_visible, (1 - is_visible) * logits]
    )
    fine = jnp.zeros((size**2, 4), points.dtype)
    fine = fine.at[cells].add(values.T, mode="drop")
    blocks = fine.reshape(side, FINER, side, FINER, 4)
    nearest, top, counts = jnp.moveaxis(jnp.max(blocks[..., :3], axis=(1, 3)), -1, 0)
    hidden = jnp.mean(blocks[..., 3], axis=(1, 3))
    hidden = jnp.where(hidden < 0, hidden, _NO_POINT)
    return PseudoRender(
        logits=jnp.where(top > 0, top, hidden),
        depths=1 / jnp.where(nearest > 0, nearest, 1),
        counts=counts,
    )


def compare_fixed_views(
    shapes: ViewMaps, batch: Mapping[str, jax.Array], *, recipe: Recipe
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Their first stage: each map against its own view; mean over objects and views.

    Cross entropy of the masks, absolute differences of u and v from the pixel's place,
    and of depth where the object covers at least half of the pixel.

    Args:
      batch: corner_masks uint8 and corner_depths [B, 8, S, S] of the fixed views.

    Returns:
      (() the weighted sum, {name of the loss: ()}).
    """
    weights, distance = recipe.weights, recipe.render.distance
    views = {"masks": batch["corner_masks"], "depths": batch["corner_depths"]}
    side = shapes.maps.shape[-2]
    signals = ("silhouette", "depth")
    targets = make_targets(views, side, signals=signals, distance=distance)
    count = shapes.maps.shape[0] * shapes.maps.shape[1]
    logits = shapes.logits.reshape(targets["silhouette"].shape)
    masks = _cross_entropy(logits, targets["silhouette"]) / count
    plane = make_planes(side, 0.0)[None, None, ..., :2]
    deviation = jnp.sum(jnp.abs(shapes.maps[..., :2] - plane)) / count
    terms = {LOSSES["silhouette"]: masks, "pixel_deviation": deviation}
    total = weights.silhouette * masks + deviation
    if weights.depth:
        depths, is_known = _read_depths(targets, distance)
        away = jnp.where(is_known, jnp.abs(shapes.maps[..., 2] - depths), 0)
        terms[LOSSES["depth"]] = jnp.sum(away) / count
        total += weights.depth * terms[LOSSES["depth"]]
    return total, terms


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


def _cross_entropy(logits, masks):
    """Sum over pixels, in nats; masks are shares of pixels."""
    return jnp.sum(optax.losses.sigmoid_binary_cross_entropy(logits, masks))


def _read_depths(targets, distance):
    """Depths of a view, and which pixels have one: at least half was measured."""
    background, measured = find_background(distance), targets["measured"]
    is_known = measured >= 0.5
    nearer = targets["depth"] - background  # times the share that is measured
    return background + nearer / jnp.where(is_known, measured, 1), is_known
