"""Reading picture files, which come damaged in many ways."""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageOps, UnidentifiedImageError

from dpc_jax import files

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
# What is decoded, whatever a file is called; the last has no mark of its own.
FORMATS = ("PNG", "JPEG", "GIF", "BMP", "PPM", "WEBP", "TIFF", "SGI", "DDS", "TGA")
MOST_PIXELS = 1 << 26  # 8192 x 8192: masking and cutting it out takes about a gigabyte
MOST_BYTES = 1 << 29  # of a file; 8192 x 8192 pixels have half of that undecoded


@contextlib.contextmanager
def open_picture(path: Path) -> Iterator[Image.Image]:
    """The picture in a file, for as long as the context, in which it can be decoded.

    Raises:
      ValueError: naming the file, if it is no picture, damaged, or has more than
        `MOST_PIXELS`; from within the context, too.
    """
    try:
        with (
            warnings.catch_warnings(),
            files.open_regular(path, most=MOST_BYTES) as file,
        ):
            warnings.simplefilter("ignore")  # what matters is an error, here or later
            with Image.open(file, formats=FORMATS) as picture:
                if picture.width * picture.height > MOST_PIXELS:
                    raise Image.DecompressionBombError(picture.size)
                yield picture
    except Image.DecompressionBombError as error:
        raise ValueError(
            f"Expected at most {MOST_PIXELS:,} pixels in the image {path}, but it has "
            f"more ({error}); make it smaller."
        ) from None
    except Exception as error:  # Pillow raises anything at all on damaged files
        raise ValueError(
            f"Expected a readable image in {path}, but it is damaged or of another "
            f"kind ({_explain(error)}); save it again as PNG, JPEG or WebP."
        ) from None


def _explain(error):
    if isinstance(error, UnidentifiedImageError):  # it would say the path again
        return "no picture that is known here"
    text = files.describe_error(error)
    return text[:1].lower() + text[1:] if text else type(error).__name__


def read_picture(path: Path) -> Image.Image:
    """The picture in a file, turned upright by its EXIF orientation.

    Raises: as `open_picture`.
    """
    with open_picture(path) as picture:
        return ImageOps.exif_transpose(picture)


def is_readable(path: Path) -> bool:
    """Whether a picture is there and whole."""
    try:
        with open_picture(path) as picture:
            picture.draft("RGB", (1, 1))  # a small decoding shows a cut file too
            picture.load()
    except ValueError:
        return False
    return True
