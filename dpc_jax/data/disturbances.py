"""What photographs have and renders do not: noise, blur, shadows, wrong masks.

Each function takes a view and a random generator and gives the view as a photograph of
it would be. Their strengths are those at which docs/predict.md says what each costs.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy import ndimage

View = tuple[np.ndarray, np.ndarray]  # image uint8 [S, S, 3], mask uint8 [S, S]

_NOISE = 0.05  # standard deviation, of white
_BLUR = 1 / 64  # standard deviation, of the image's side: a pixel of 64
_SHADE = 0.5  # of the light, that a shadow leaves
_PENUMBRA = 0.03  # width of its edge, of the image's side
_AWAY = 0.1  # of the image's side, from its middle
_WRONG = 0.05  # of the mask's area
_BLOBS = (0.02, 0.06)  # radii of what is wrong, of the image's side
_BACKGROUND = (60, 200)  # grey of what is taken for the object and is not


def add_noise(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> View:
    """Normal noise of 5 % of white in every pixel and channel."""
    return _to_bytes(image + rng.normal(0, 255 * _NOISE, image.shape)), mask


def blur(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> View:
    """A Gaussian of one pixel of 64."""
    del rng
    width = _BLUR * len(mask)
    soft = ndimage.gaussian_filter(image.astype(np.float32), (width, width, 0))
    return _to_bytes(soft), mask


def blur_mask(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> View:
    """The mask is blurred as `blur` does images; the image is sharp."""
    del rng
    soft = ndimage.gaussian_filter(mask.astype(np.float32), _BLUR * len(mask))
    return image, _to_bytes(soft)


def cast_shadow(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> View:
    """Half of the object, along a random line near the middle, has half the light."""
    angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(-0.15, 0.15)
    place = (np.arange(len(mask)) + 0.5) / len(mask) - 0.5  # of a row or column
    beyond = np.cos(angle) * place + np.sin(angle) * place[:, None] - away
    is_shaded = 1 / (1 + np.exp(-beyond / _PENUMBRA))
    white = 255.0 - mask[..., None]  # that the background adds to a pixel
    light = 1 - (1 - _SHADE) * is_shaded[..., None]
    return _to_bytes(white + (image - white) * light), mask


def move_off_centre(
    image: np.ndarray, mask: np.ndarray, rng: np.random.Generator
) -> View:
    """All of it lies a tenth of the image's side away, in a random direction."""
    angle, side = rng.uniform(0, 2 * np.pi), len(mask)
    down, right = np.rint(_AWAY * side * np.array([np.sin(angle), np.cos(angle)]))
    return (
        ndimage.shift(image, (down, right, 0), order=0, cval=255),
        ndimage.shift(mask, (down, right), order=0, cval=0),
    )


def spoil_mask(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> View:
    """Discs at the rim are lost or added until 5 % of the area is wrong.

    What is lost is white; what is added shows a grey background.
    """
    is_object, side = mask > 127, len(mask)
    inner = np.asarray(ndimage.binary_erosion(is_object), bool)
    rim = np.argwhere(is_object & ~inner)
    rows, columns = np.ogrid[:side, :side]
    found = is_object.copy()
    while len(rim) and (found != is_object).sum() < _WRONG * is_object.sum():
        row, column = rim[rng.integers(len(rim))]
        radius = side * rng.uniform(*_BLOBS)
        is_near = (rows - row) ** 2 + (columns - column) ** 2 < radius**2
        found = np.where(is_near, rng.random() < 0.5, found)
    if not found.any():  # of so small an object
        return image, mask
    is_wrong = (found != is_object)[..., None]
    grey = rng.integers(*_BACKGROUND)
    spoiled = np.where(is_wrong, np.where(found[..., None], grey, 255), image)
    mask = np.where(is_wrong[..., 0], 255 * found, mask)
    return spoiled.astype(np.uint8), mask.astype(np.uint8)


DISTURBANCES: Mapping[str, Callable[..., View]] = {
    "noise": add_noise,
    "blur": blur,
    "blurred mask": blur_mask,
    "shadow": cast_shadow,
    "off centre": move_off_centre,
    "wrong mask": spoil_mask,
}


def _to_bytes(values):
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
