"""Reading picture files, which come damaged in many ways."""

from pathlib import Path

from PIL import Image, ImageOps

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
FAULTS = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)  # of Pillow


def read_picture(path: Path) -> Image.Image:
    """The picture in a file, turned upright by its EXIF orientation."""
    try:
        with Image.open(path) as image:
            return ImageOps.exif_transpose(image)
    except FAULTS as error:
        raise ValueError(
            f"Expected a readable image in {path}, but got {type(error).__name__}: "
            f"{error}; repair or remove it."
        ) from None


def is_readable(path: Path) -> bool:
    """Whether a picture is there and whole."""
    try:
        with Image.open(path) as picture:
            picture.draft("RGB", (1, 1))  # a small decoding shows a cut file too
            picture.load()
    except FAULTS:
        return False
    return True
