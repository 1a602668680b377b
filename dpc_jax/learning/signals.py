"""The signals that renders and views are compared in: silhouette, depth and colour.

Both sides of a comparison are mixed with the same background, by the share of the pixel
that shows it: a view by its mask, a render by the probability that its ray ends nowhere
(Eq. 5). So a pixel on the edge of an object compares like with like, and so does a
pixel of the render's grid that covers several of the view. For depth the background is
the far face of the volume, as in the paper, whose D₃+1-st cell lies right behind it: a
missing point then costs no more than one that is half a diagonal too near.

Depths are not compared as means of a ray: a mean is right, too, where half of the mass
is too near and half too far. What is compared is where a ray may end: every cell costs
its distance from the true depth, by the probability that the ray ends there (the ray
consistency of Tulsiani et al., CVPR 2017).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.render import Camera, Projection, VoxelGrid

# Signals, and the names of their losses.
LOSSES = {"silhouette": "reprojection", "depth": "depth", "color": "color"}
# Optical depth of an object in `spread_masks`: so much mass lies on a pixel. With 5
# evenly spaced true points of cars and chairs have their least loss at their own size,
# with 3 shrunk by about 1.5 %.
_OPTICAL_DEPTH = 5.0


class Weights(NamedTuple):
    """Weights of the losses of a view's signals, per pixel; static.

    Depths are in box diagonals. A signal of weight 0 is neither rendered nor read.

    Attributes:
      silhouette, depth, color: of the signals.
      background: above 0 silhouettes are compared by their event cost, in which a
        pixel of the background has this weight and one of the object 1.
      spreads_masks: whether silhouettes are compared with `spread_masks`.
    """

    silhouette: float = 1.0
    depth: float = 0.0
    color: float = 0.0
    background: float = 0.0
    spreads_masks: bool = False

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals that have a weight."""
        return tuple(name for name in LOSSES if getattr(self, name))

    @property
    def renders(self) -> tuple[str, ...]:
        """What `project` renders to compare them."""
        names = {"depth": "termination"}
        return tuple(names.get(signal, signal) for signal in self.signals)


SILHOUETTES = Weights()


def find_background(distance: Any) -> Any:
    """Depth of the background: the far face of the volume, `distance` + 1/2; ()."""
    return distance + 0.5


def downsample_images(images: jax.Array, size: int) -> jax.Array:
    """Average bytes [..., S, S] over blocks, to [..., size, size] in [0, 1]."""
    return average_blocks(images.astype(jnp.float32), size) / 255


def spread_masks(masks: jax.Array) -> jax.Array:
    """Masks [..., D, D] in [0, 1] as points of the object would draw them.

    A point is shared out to the two cells around it along each axis, and little mass
    stops a ray: drawn by points, an object is about half a cell wider on each side than
    its mask. Shapes that are compared with the mask itself shrink by as much, and thin
    parts, which cover their pixels in part, dissolve. With b, the mask after points
    spread evenly over their pixels are shared out, it is (1 - exp(-κb))/(1 - exp(-κ))
    of the optical depth κ. Not in the paper.
    """
    for axis in (-2, -1):
        edges = [(0, 0)] * masks.ndim
        edges[axis] = (1, 1)
        wide, size = jnp.pad(masks, edges), masks.shape[axis]
        before, after = (
            jax.lax.slice_in_dim(wide, start, start + size, axis=axis)
            for start in (0, 2)
        )
        masks = 0.75 * masks + 0.125 * (before + after)
    return jnp.expm1(-_OPTICAL_DEPTH * masks) / jnp.expm1(-_OPTICAL_DEPTH)


def average_blocks(images: jax.Array, size: int) -> jax.Array:
    """Means of the square blocks of images [..., S, S], to [..., size, size]."""
    factor = images.shape[-1] // size
    blocks = images.reshape(*images.shape[:-2], size, factor, size, factor)
    return jnp.mean(blocks, axis=(-3, -1))


def make_targets(
    views: Mapping[str, Any],
    side: int,
    *,
    signals: tuple[str, ...],
    distance: float,
    spreads_masks: bool = False,
) -> dict[str, jax.Array]:
    """What renders of a view should look like, averaged down to the render's grid.

    Args:
      views: of the arrays that the signals need: masks uint8 [..., S, S], images uint8
        [..., S, S, 3] on white, depths [..., S, S], metric z of what the mask covers.
        A depth of 0 was not measured: the pixel counts as background.
      side: D of the grid, a divisor of S.
      signals: any of `LOSSES`. distance: of the camera.
      spreads_masks: whether silhouettes are `spread_masks`.

    Returns:
      {signal: [..., D, D] or, of colours, [..., D, D, 3]}; colours and silhouettes in
      [0, 1]. Beside depths there is "measured" [..., D, D], the share that has one.
    """
    targets = {}
    if "silhouette" in signals:
        silhouettes = downsample_images(views["masks"], side)
        targets["silhouette"] = (
            spread_masks(silhouettes) if spreads_masks else silhouettes
        )
    if "depth" in signals:
        background, depths = find_background(distance), views["depths"]
        covered = jnp.where(depths > 0, views["masks"].astype(jnp.float32) / 255, 0)
        nearer = average_blocks(covered * (depths - background), side)
        targets["depth"] = background + nearer
        targets["measured"] = average_blocks(covered, side)
    if "color" in signals:
        channels = jnp.moveaxis(views["images"], -1, -3)
        targets["color"] = jnp.moveaxis(downsample_images(channels, side), -3, -1)
    return targets


def compare_images(
    image: Projection,
    targets: Mapping[str, jax.Array],
    *,
    weights: Weights,
    camera: Camera,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """A term of Eq. 1: differences of a view's images, summed over pixels.

    Returns:
      (() the weighted sum, {name of the loss: ()}).
    """
    total, terms = jnp.zeros(()), {}
    for signal in weights.signals:
        if signal == "depth":
            is_alone = not weights.silhouette
            term = compare_depths(image, targets, camera=camera, is_alone=is_alone)
        else:
            rendered, target = getattr(image, signal), targets[signal]
            if signal == "silhouette" and weights.background:
                # Ray consistency with a mask (Tulsiani et al., CVPR 2017): 1 that a ray
                # of the object passes, `background` that another one is stopped.
                missed = jnp.sum(target * (1 - rendered))
                term = missed + weights.background * jnp.sum((1 - target) * rendered)
            else:
                term = reprojection_loss(rendered, target)
        terms[LOSSES[signal]] = term
        total = total + getattr(weights, signal) * term
    return total, terms


def compare_depths(
    image: Projection,
    targets: Mapping[str, jax.Array],
    *,
    camera: Camera,
    is_alone: bool,
) -> jax.Array:
    """How far rays end from the true depth, expected and summed over pixels; ().

    Σ_k r_k·max(|z_k + h - d| - h, 0) in box diagonals, where h is a cell: the rays of a
    smoothed surface end up to two cells before it. Counted by the share of the pixel
    whose depth was measured.

    Args:
      is_alone: where no silhouettes are compared, depths have to teach the outline. The
        squared difference of mean depths is added then, the background's included, by
        which rays that miss an object or hit beside it are wrong.
    """
    ends = image.termination
    assert ends is not None
    background, measured = find_background(camera.distance), targets["measured"]
    places = VoxelGrid(ends.shape[-1]).depths(camera, ends.dtype)[None, None]
    nearer = targets["depth"] - background  # times the share that is measured
    depth = background + nearer / jnp.where(measured > 0, measured, 1)
    cell = 1 / ends.shape[-1]
    away = jnp.abs(places + cell - depth[..., None]) - cell
    cost = measured[..., None] * jnp.maximum(away, 0)
    total = jnp.sum(ends * cost)
    if is_alone:
        # Of the rays that miss or hit, the squares: as of silhouettes.
        total += reprojection_loss(jnp.sum(ends * (places - background), -1), nearer)
    return total
