"""Errors of rendered images: silhouettes, and depth and colour where the object is."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

# Side in pixels at which silhouettes are compared. Fixed, because their edge, where
# most of the error lies, is a smaller share of a finer image.
COMPARED_SIDE = 32
COVERED = 0.5  # least share of a pixel for the pixel to count
MISSED = 0.1  # least share of a pixel that is hit for it to have a depth


class ViewImages(NamedTuple):
    """A view as the data have it and as it is rendered, at the size of the renders.

    Images are by signal ("silhouette", "depth", "color"), [D, D] or [D, D, 3]. Depths
    are of what is hit, without the background that is mixed in where they are compared
    in training: an opacity that is too low is an error of the silhouette, not of depth.
    Where less than `MISSED` is hit they are the background's. What is measured is the
    share of each pixel that the object covers and whose depth is known.
    """

    measured: np.ndarray
    targets: Mapping[str, np.ndarray]
    rendered: Mapping[str, np.ndarray]


def depth_error(predicted: ArrayLike, true: ArrayLike, mask: ArrayLike) -> float | None:
    """Mean absolute difference of depths [..., D, D] where the mask [..., D, D] covers.

    None where no pixel is covered.
    """
    is_covered = np.asarray(mask) >= COVERED
    if not is_covered.any():
        return None
    return float(np.abs(np.asarray(predicted) - np.asarray(true))[is_covered].mean())


def color_psnr(predicted: ArrayLike, true: ArrayLike, mask: ArrayLike) -> float | None:
    """Peak signal-to-noise ratio of [..., D, D, C] in [0, 1] where the mask covers, dB.

    That of a mean squared difference of 1e-10 at most; None where no pixel is covered.
    """
    is_covered = np.asarray(mask) >= COVERED
    if not is_covered.any():
        return None
    square = (np.asarray(predicted) - np.asarray(true))[is_covered] ** 2
    return float(-10 * np.log10(max(square.mean(), 1e-10)))


def measure_overlap(first: ArrayLike, second: ArrayLike) -> float:
    """Intersection over union of two soft silhouettes [S, S], 0 to 1."""
    union = np.maximum(first, second).sum()
    return float(np.minimum(first, second).sum() / max(union, 1e-9))


def mean_squared_difference(predicted: ArrayLike, target: ArrayLike) -> float:
    """Mean squared difference per pixel of two images [S, S] in [0, 1], at one size."""
    difference = resize(predicted, COMPARED_SIDE) - resize(target, COMPARED_SIDE)
    return float(np.mean(difference**2))


def resize(image: ArrayLike, side: int) -> np.ndarray:
    """An image [S, S] at `side` pixels, float64: averaged over blocks, or repeated.

    One of the sides divides the other, as those of data and of renders do.
    """
    array = np.asarray(image, np.float64)
    own = len(array)
    if own < side:
        return array.repeat(side // own, axis=0).repeat(side // own, axis=1)
    factor = own // side
    return array.reshape(side, factor, side, factor).mean(axis=(1, 3))
