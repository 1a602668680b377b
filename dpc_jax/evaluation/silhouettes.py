"""How far a rendered silhouette is from the true one, whatever their sizes."""

import numpy as np
from numpy.typing import ArrayLike

# Side in pixels at which images are compared. Fixed, because a silhouette's edge, where
# most of the error lies, is a smaller share of a finer image.
COMPARED_SIDE = 32


def mean_squared_difference(
    predicted: ArrayLike, target: ArrayLike, *, side: int = COMPARED_SIDE
) -> float:
    """Mean squared difference per pixel of two images [S, S] in [0, 1].

    Both are brought to `side` pixels: averaged over blocks where they are finer,
    repeated where they are coarser. Their own sizes may differ.

    Raises:
      ValueError: for an image that is not square, or whose side neither divides nor is
        divided by that number.
    """
    difference = resize(predicted, side) - resize(target, side)
    return float(np.mean(difference**2))


def resize(image: ArrayLike, side: int) -> np.ndarray:
    """An image [S, S] at `side` pixels, float64: averaged over blocks, or repeated."""
    array = np.asarray(image, np.float64)
    is_square = array.ndim == 2 and array.shape[0] == array.shape[1] > 0
    own = array.shape[0] if is_square else 0
    if not own or (own % side and side % own):
        raise ValueError(
            f"Expected a square image whose side divides {side} pixels or is a "
            f"multiple of it, but its shape is {array.shape}; give for example "
            f"{side} × {side} pixels."
        )
    if own < side:
        return array.repeat(side // own, axis=0).repeat(side // own, axis=1)
    factor = own // side
    return array.reshape(side, factor, side, factor).mean(axis=(1, 3))
