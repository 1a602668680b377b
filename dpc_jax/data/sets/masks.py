"""Masks of images: given in a file, or found before a plain background."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

from dpc_jax.data.sets.pictures import SUFFIXES, read_picture

_SIDE = 512  # longest, of the image that is looked at: a mask is smooth beyond that
_BORDER = 0.03  # of the image's shorter side, that shows background on all sides
_LEAST_CONTRAST = 8.0  # of object and background in CIELAB; 2 is just noticeable
_NOISE_FACTOR = 4.0  # standard deviations of noise that are still background
_MOST_NOISE = 12.0  # of the background about its smooth surface, CIELAB
_MOST_UNLIKE = 0.45  # share of the border that the background leaves unexplained
_TRIMMINGS = 8  # rounds of fitting without what does not fit
_DARKEST_SHADOW = 0.4  # that a shadow takes of the background's lightness
_SHADE = 0.35  # weight of a darkening that may be a shadow
_LEAST_KEPT = 0.65  # of the object's area, without what may be its shadow
_SPECK = 2e-3  # of the object's area: a smaller hole is noise
_EDGE = 2  # pixels that blur widens an object by
_LEAST_AREA = 0.002  # of the image
# Of 75 procedural objects before plain backgrounds none had less than 0.96 of what
# stands out, and none touched the border. Textures and scenes that fill the frame have
# 0.01 to 0.9, or cover 7 to 40 % of the border.
_LEAST_SHARE = 0.9
_MOST_TOUCHED = 0.05


def check_mask(mask: np.ndarray, source: str) -> None:
    """Raise ValueError for a mask of 0 to 1 above one half everywhere or nowhere."""
    most = float(mask.max())
    if mask.min() <= 0.5 < most:
        return
    problem = f"is nowhere more than {100 * most:.0f} % opaque" if most else "is empty"
    if most > 0.5:
        problem = "covers the whole image"
    raise ValueError(
        f"Expected a mask of the object in {source}, but it {problem}; make it again."
    )


def read_mask(image: Image.Image, path: Path, *, advice: str = "") -> np.ndarray:
    """The mask float32 [height, width] of 0 to 1 of an upright image of a file.

    Raises:
      ValueError: where the mask file has another size or cannot be read, or there is
        neither an alpha channel nor a mask file; that sentence ends in the advice.
    """
    beside = find_mask_file(path)
    if beside is not None:
        mask = read_picture(beside)
        if mask.mode.startswith("I"):  # 16 bits, which Pillow would cut off at 255
            mask = Image.fromarray((np.asarray(mask) >> 8).astype(np.uint8))
        mask = np.asarray(mask.convert("L"))
        if mask.shape != image.size[::-1]:
            raise ValueError(
                f"Expected {beside} of the size of {path.name}, {image.size}, but it "
                f"has {mask.shape[::-1]}; make it again."
            )
    elif image.has_transparency_data:
        mask = np.asarray(image.convert("RGBA"))[..., 3]
    else:
        raise ValueError(
            f"Expected an alpha channel in {path} or {path.stem}_mask.png beside it, "
            f"but found neither; add a mask{advice}."
        )
    return mask.astype(np.float32) / 255.0


def find_mask_file(path: Path) -> Path | None:
    """The mask that lies beside an image."""
    for suffix in (".png", *SUFFIXES):
        mask = path.with_name(f"{path.stem}_mask{suffix}")
        if os.path.isfile(mask):  # False for a name that is too long, too
            return mask
    return None


def find_before_plain_background(colors: np.ndarray) -> np.ndarray:
    """The mask float32 [height, width] of 0 to 1 of an object, in a uint8 image.

    The background may be noisy and lit unevenly: a smooth surface is fitted to the
    colours along the border, in CIELAB, where distances are about as large as they
    look. What differs from it by more than Otsu's threshold is the object.

    Raises:
      ValueError: where the background is not plain, or nothing stands out from it; the
        sentence begins with "Expected a plain background".
    """
    from skimage import color, filters  # it takes a while, and few commands need it

    height, width = colors.shape[:2]
    ratio = min(1.0, _SIDE / max(height, width))
    size = max(8, round(width * ratio)), max(8, round(height * ratio))
    small = np.asarray(Image.fromarray(colors).resize(size, Image.Resampling.BOX))
    lab = color.rgb2lab(small).astype(np.float32)
    background, noise = _fit_background(lab)
    # Noise of single pixels averages out; an edge moves by less than a pixel.
    smooth = ndimage.gaussian_filter(lab - background, (1.0, 1.0, 0.0))
    away = np.linalg.norm(smooth, axis=-1)
    lit = np.minimum(away, _discount_shadows(smooth, background))
    found = []
    for distance in (away, lit):
        # Half of Otsu's threshold: parts of an object may be like the background.
        threshold = 0.5 * filters.threshold_otsu(np.minimum(distance, 60.0))
        threshold = max(threshold, _LEAST_CONTRAST / 2, _NOISE_FACTOR * noise / 3)
        largest, share = _keep_largest(distance, threshold)
        found.append((_trim_edge(largest, distance), share))
    # An object of the background's own hue is not its own shadow.
    (whole, _), (without, _) = found
    mask, share = found[int(without.sum() > _LEAST_KEPT * whole.sum())]
    contrast = np.median(away[mask]) if mask.any() else 0.0
    if mask.mean() < _LEAST_AREA or contrast < _LEAST_CONTRAST:
        raise ValueError(
            "Expected a plain background with an object that stands out, but nothing "
            "differs enough from the border's colours; give a mask."
        )
    if share < _LEAST_SHARE:
        raise ValueError(
            "Expected a plain background with one object, but what stands out lies in "
            f"pieces, the largest of which is {100 * share:.0f} % of it; give a mask, "
            "or take the picture before a plain wall or sheet."
        )
    edges = mask[0], mask[-1], mask[:, 0], mask[:, -1]
    touched = float(np.concatenate(edges).mean())
    if touched > _MOST_TOUCHED:
        raise ValueError(
            "Expected a plain background around the object, but what stands out covers "
            f"{100 * touched:.0f} % of the image's border; leave a margin, or give a "
            "mask."
        )
    large = Image.fromarray(mask.astype(np.float32)).resize(
        (width, height), Image.Resampling.BILINEAR
    )
    return np.asarray(large, np.float32)


def _fit_background(lab):
    """A quadratic surface [h, w, 3] through the border's colours, and the noise."""
    height, width = lab.shape[:2]
    margin = max(2, round(_BORDER * min(height, width)))
    is_border = np.ones((height, width), bool)
    is_border[margin:-margin, margin:-margin] = False
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    rows, values = terms[is_border], lab[is_border]
    # It begins with what most of the border has: its median colour.
    away = np.linalg.norm(values - np.median(values, axis=0), axis=1)
    kept = away <= max(float(np.median(away)) * 2.5, _MOST_NOISE)
    for _ in range(_TRIMMINGS):  # without what lies off: objects may reach there
        surface, *_ = np.linalg.lstsq(rows[kept], values[kept], rcond=None)
        away = np.linalg.norm(values - rows @ surface, axis=1)
        noise = float(np.median(away[kept]))
        kept = away <= max(3.0 * noise, 1.0)
    unlike = float(np.mean(away > max(3.0 * noise, _LEAST_CONTRAST)))
    if noise > _MOST_NOISE or unlike > _MOST_UNLIKE:
        raise ValueError(
            "Expected a plain background, but the border of the image shows several "
            f"colours ({100 * unlike:.0f} % of it differ from the rest); give a mask, "
            "or take the picture before a plain wall or sheet."
        )
    return (terms @ surface).astype(np.float32), noise


def _discount_shadows(smooth, background):
    """How far each pixel's colour is from the background's, shadows counted for less.

    A shadow makes the background darker by at most a share, and hardly changes its hue.
    """
    lightness = smooth[..., 0]
    base = np.maximum(background[..., 0], 1.0)
    shade = np.clip(-lightness, 0.0, _DARKEST_SHADOW * base)
    # In shadow, colours fade with the light.
    faded = background[..., 1:] * (shade / base)[..., None]
    rest = np.stack([lightness + shade, *np.moveaxis(smooth[..., 1:] + faded, -1, 0)])
    return np.hypot(np.linalg.norm(rest, axis=0), _SHADE * shade)


def _keep_largest(away, threshold):
    """The largest connected part above a threshold, and its share of all such parts.

    Specks are closed; a hole that shows the background stays open.
    """
    mask = np.asarray(ndimage.binary_opening(away > threshold), bool)
    found: Any = ndimage.label(mask, np.ones((3, 3)))
    labels, count = found
    if not count:
        return mask, 0.0
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    largest = np.asarray(
        ndimage.binary_closing(np.pad(labels == areas.argmax(), 2), np.ones((3, 3))),
        bool,
    )[2:-2, 2:-2]
    filled = np.asarray(ndimage.binary_fill_holes(largest), bool)
    found = ndimage.label(filled & ~largest)
    holes, count = found
    for number in range(1, count + 1):
        hole = holes == number
        is_large = hole.sum() > _SPECK * largest.sum()
        if is_large and np.median(away[hole]) < threshold / 2:
            filled[hole] = False
    return filled, float(areas.max() / areas.sum())


def _trim_edge(mask, away):
    """The mask without those pixels of its edge that are mostly background."""
    inner = ndimage.binary_erosion(mask, np.ones((3, 3)), iterations=_EDGE)
    nearby = ndimage.grey_dilation(np.where(mask, away, 0.0), size=2 * _EDGE + 1)
    trimmed = mask & (inner | (away > 0.5 * np.minimum(nearby, 60.0)))
    return trimmed if trimmed.sum() > 0.5 * mask.sum() else mask
