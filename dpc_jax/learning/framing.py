"""Views of unknown distance: framed alike, whatever camera took them.

Renders of a data set are seen from one distance, with the middle of the object in the
middle of the image. A photograph says neither. So the network learns from both: half of
the views of a batch are framed by the box of their mask. Silhouettes, of which one is
predicted, are compared after both are framed by their moments, which change little
where a mask is wrong by some pixels; what is left of shift and size does not count.

`data.sets.framing` cuts files out once, before training; this is done in its programs.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.config import FILL
from dpc_jax.networks import ShapePoseNetwork

Array = jax.Array | np.ndarray

_FARTHEST = 0.1  # widths that a frame by moments may be moved by, and share of its side
_SPREAD = 0.25  # root mean square distance from the centre in a frame by moments


class Frame(NamedTuple):
    """A square of an image, in widths of the image from its middle.

    Attributes:
      centre: [..., 2], row before column. side: [...].
    """

    centre: Any
    side: Any


def frame_by_box(masks: Array) -> Frame:
    """Frames about the boxes of masks uint8 [..., S, S]; the whole of an empty one."""

    @functools.partial(jnp.vectorize, signature="(s,s)->(k),()")
    def find_frame(mask):
        is_covered, size = mask > 127, len(mask)
        ends = []
        for axis in (1, 0):
            line = jnp.any(is_covered, axis)
            ends.append(jnp.stack([jnp.argmax(line), size - jnp.argmax(line[::-1])]))
        low, high = jnp.stack(ends, axis=1) / size - 0.5
        side = jnp.where(jnp.any(is_covered), jnp.max(high - low) / FILL, 1)
        return (low + high) / 2, side

    return Frame(*find_frame(masks))


def frame_by_moments(silhouettes: Array) -> Frame:
    """Frames about the centres of silhouettes [..., S, S] from 0 to 1, by their spread.

    Of one that shows nothing, a frame of a pixel's spread about the middle.
    """

    @functools.partial(jnp.vectorize, signature="(s,s)->(k),()")
    def find_frame(silhouette):
        size = len(silhouette)
        places, total = _list_places(size), jnp.maximum(jnp.sum(silhouette), 1e-6)
        lines = jnp.stack([jnp.sum(silhouette, axis) for axis in (1, 0)]) / total
        centre = lines @ places
        square = jnp.sum(lines @ places**2) - jnp.sum(centre**2)
        return centre, jnp.sqrt(jnp.maximum(square, 1 / size**2)) / _SPREAD

    return Frame(*find_frame(silhouettes))


def find_place(given: Frame, wanted: Frame) -> Frame:
    """The frame of an image in which what has the frame `given` has that `wanted`."""
    side = given.side / wanted.side
    return Frame(given.centre - side[..., None] * wanted.centre, side)


def cut_out(images: Array, frame: Frame) -> jax.Array:
    """What is in the frames of images [..., S, S, C], in as many pixels; 0 beyond them.

    Bilinear where pixels grow, else means over the pixels that one is made of.
    """

    @functools.partial(jnp.vectorize, signature="(s,s,c),(k),()->(s,s,c)")
    def cut(image, centre, side):
        size = len(image)
        places, width = _list_places(size), jnp.maximum(side, 1) / size

        def weigh(middle):
            away = (middle + side * places)[:, None] - places[None]
            weights = jnp.maximum(1 - jnp.abs(away) / width, 0)
            # Where pixels shrink a row adds up to about how many of them make one.
            return weights / jnp.maximum(jnp.sum(weights, axis=1, keepdims=True), 1)

        rows, columns = weigh(centre[0]), weigh(centre[1])
        return jnp.einsum("ij,jkc,lk->ilc", rows, image, columns)

    return cut(images, frame.centre, frame.side)


def cut_silhouettes(silhouettes: Array, frame: Frame) -> jax.Array:
    """`cut_out` of silhouettes [..., S, S]."""
    return cut_out(silhouettes[..., None], frame)[..., 0]


def fit_frame(frame: Frame, silhouette: Array, wanted: Array) -> Frame:
    """The frame in which a silhouette [S, S] is more like `wanted` [S, S].

    A Gauss-Newton step of the shift and the size from `frame`: where a mask or a shape
    is wrong by some pixels, so are its moments.
    """
    seen, size = cut_silhouettes(silhouette, frame), len(silhouette)
    places = _list_places(size)
    down, right = (size * edges for edges in jnp.gradient((seen + wanted) / 2))
    larger = places[:, None] * down + places[None] * right
    moves = jnp.stack([down, right, larger]).reshape(3, -1)
    # What has no edges does not change when it moves; with the 1 it can be solved.
    fitted = jnp.linalg.solve(
        moves @ moves.T + jnp.eye(3), moves @ (seen - wanted).ravel()
    )
    fitted = jnp.clip(fitted, -_FARTHEST, _FARTHEST)
    return Frame(frame.centre - frame.side * fitted[:2], frame.side * (1 - fitted[2]))


def make_inputs(
    images: jax.Array,
    masks: jax.Array,
    *,
    network: ShapePoseNetwork,
    is_framed: jax.Array | bool = False,
) -> jax.Array:
    """What the network sees of images uint8 [..., S, S, 3] with masks [..., S, S].

    Bytes 0 to 255 become numbers from -1 to 1. Views that `is_framed` [...] says are
    cut out by the boxes of their masks first.
    """
    # What lies beyond an image is white, and nothing of the object.
    away = jnp.concatenate([255 - images, masks[..., None]], axis=-1)
    away = away.astype(jnp.float32) / 127.5
    if is_framed is not False:
        is_framed, box = jnp.asarray(is_framed), frame_by_box(masks)
        centre = jnp.where(is_framed[..., None], box.centre, 0)
        away = cut_out(away, Frame(centre, jnp.where(is_framed, box.side, 1)))
    inputs = 1 - away[..., :3]
    if not network.sees_mask:
        return inputs
    return jnp.concatenate([inputs, away[..., 3:] - 1], axis=-1)


def draw_framed(keys: jax.Array) -> jax.Array:
    """Which views [n] of a batch are framed, by their keys [n]: half.

    The other half shows sizes as they are, which tell more of a shape.
    """
    return jax.vmap(lambda key: jax.random.bernoulli(jax.random.fold_in(key, 1)))(keys)


def _list_places(size):
    return (jnp.arange(size) + 0.5) / size - 0.5
