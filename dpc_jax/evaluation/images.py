"""Errors of rendered images: depth and colour, where the true mask covers a pixel."""

import numpy as np
from numpy.typing import ArrayLike

COVERED = 0.5  # least share of a pixel for the pixel to count


def depth_error(predicted: ArrayLike, true: ArrayLike, mask: ArrayLike) -> float | None:
    """Mean absolute difference of depths over the pixels that the mask covers.

    Args:
      predicted, true: [..., D, D] metric z. mask: [..., D, D] in [0, 1].

    Returns:
      In units of depth; None where no pixel is covered.
    """
    is_covered = np.asarray(mask) >= COVERED
    if not is_covered.any():
        return None
    return float(np.abs(np.asarray(predicted) - np.asarray(true))[is_covered].mean())


def color_psnr(predicted: ArrayLike, true: ArrayLike, mask: ArrayLike) -> float | None:
    """Peak signal-to-noise ratio over the pixels that the mask covers, in dB.

    Args:
      predicted, true: [..., D, D, C] in [0, 1]. mask: [..., D, D] in [0, 1].

    Returns:
      -10 log₁₀ of the mean squared difference, that of 1e-10 at most; None where no
      pixel is covered.
    """
    is_covered = np.asarray(mask) >= COVERED
    if not is_covered.any():
        return None
    square = (np.asarray(predicted) - np.asarray(true))[is_covered] ** 2
    return float(-10 * np.log10(max(square.mean(), 1e-10)))


def mean_of_known(values: list[float | None]) -> float | None:
    """The mean of those that are not None; None if there is none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
