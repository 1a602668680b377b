"""Reading pictures and videos, which come damaged in many ways.

Videos are read by the library PyAV, an extra: `pip install "dpc_jax[video]"`.
"""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, ImageSequence, UnidentifiedImageError

from dpc_jax import files
from dpc_jax.files import Damage

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg")
# What is decoded, whatever a file is called; the last has no mark of its own.
FORMATS = ("PNG", "JPEG", "GIF", "BMP", "PPM", "WEBP", "TIFF", "SGI", "DDS", "TGA")
MOVING = ("GIF", "WEBP", "PNG", "TIFF")  # of JPEG further pictures are thumbnails
MOST_PIXELS = 1 << 26  # 8192 x 8192: masking and cutting it out takes about a gigabyte
MOST_BYTES = 1 << 29  # of a file; 8192 x 8192 pixels have half of that undecoded
MOST_SIDE = 1280  # pixels of a frame that is kept: a film in 720p stays as it is


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
        reason = files.describe_error(error) or type(error).__name__
        if isinstance(error, UnidentifiedImageError):  # it would say the path again
            reason = "no picture that is known here"
        raise ValueError(
            f"Expected a readable image in {path}, but it is damaged or of another "
            f"kind ({reason}); save it again as PNG, JPEG or WebP."
        ) from None


def read_picture(path: Path) -> Image.Image:
    """The picture in a file, turned upright by its EXIF orientation.

    Raises: as `open_picture`.
    """
    with open_picture(path) as picture:
        return ImageOps.exif_transpose(picture)


def check_picture(path: Path):
    """Raise as `open_picture` does, also where the picture in a file is cut."""
    with open_picture(path) as picture:
        picture.draft("RGB", (1, 1))  # a small decoding shows a cut file too
        picture.load()


def to_colors(image: Image.Image) -> np.ndarray:
    """Colours uint8 [height, width, 3] of a picture, without its alpha channel."""
    return np.asarray(image.convert("RGBA").convert("RGB"))


def read_frames(path: Path, most: int) -> list[Image.Image]:
    """At most so many frames of a picture or video, upright, in equal steps.

    Where there are several, they are shrunk to `MOST_SIDE`, to keep all of them.

    Raises:
      ValueError: where it cannot be read, or where PyAV is needed and not installed.
    """
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return _read_video(path, most)
    with open_picture(path) as image:
        count = getattr(image, "n_frames", 1) if image.format in MOVING else 1
        if count == 1:
            return [ImageOps.exif_transpose(image)]
        chosen = {int(i * count / most) for i in range(most)}
        return [
            shrink(ImageOps.exif_transpose(frame))
            for number, frame in enumerate(ImageSequence.Iterator(image))
            if number in chosen
        ]


def _read_video(path, most):
    # How long a video is is not asked: many files do not know it. So frames are kept in
    # steps that double whenever there are too many, and memory stays small.
    try:
        import av
        from av.error import FFmpegError
    except ImportError as error:
        raise ValueError(
            f"Expected the library PyAV for the video {path}, but it cannot be loaded "
            f'({error}); install it with: pip install "dpc_jax[video]".'
        ) from None
    kept, step = [], 1
    try:
        # Absolute: "concat:a" is to be a file, and no order to the library.
        with av.open(str(path.absolute())) as container:
            for number, frame in enumerate(container.decode(video=0)):
                if number % step:
                    continue
                if frame.width * frame.height > MOST_PIXELS:
                    raise Damage(f"its frames have {frame.width} x {frame.height}")
                # upright, because telephones store how they were held
                image = frame.to_image().rotate(frame.rotation, expand=True)
                kept.append(shrink(image))
                if len(kept) == 4 * most:
                    kept, step = kept[::2], 2 * step
        if not kept:
            raise Damage("no frame of it can be decoded")
    except (FFmpegError, IndexError, ValueError) as error:
        reason = str(error).split(":")[0] or type(error).__name__
        raise ValueError(
            f"Expected a readable video in {path}, but it is damaged or of another "
            f"kind ({reason}); save it again as MP4, or give a folder of its frames."
        ) from None
    chosen = range(min(most, len(kept)))
    return [kept[i * len(kept) // len(chosen)] for i in chosen]


def shrink(frame: Image.Image) -> Image.Image:
    """A frame of at most `MOST_SIDE` pixels a side, by means over whole pixels."""
    factor = -(-max(frame.size) // MOST_SIDE)
    if factor == 1:
        return frame
    if frame.mode != "RGB" or "transparency" in frame.info:
        frame = frame.convert("RGBA")
    return frame.reduce(factor)
