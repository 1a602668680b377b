"""Frames of a video file, by the library PyAV.

An extra: `pip install "dpc_jax[video]"`.
"""

from pathlib import Path
from typing import Any

from PIL import Image

from dpc_jax.data.sets.pictures import MOST_PIXELS
from dpc_jax.files import Damage

MOST_SIDE = 1280  # pixels of a frame that is kept: a film in 720p stays as it is
SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg")


def read_frames(path: Path, most: int) -> list[Image.Image]:
    """At most so many frames, upright, in equal steps from the first one on.

    How long a video is is not asked: many files do not know it. So frames are kept in
    steps that double whenever there are too many, and memory stays small.

    Raises:
      ValueError: where PyAV is not installed, or the file has no frame to decode.
    """
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
                kept.append(shrink(_turn_upright(frame)))
                if len(kept) == 4 * most:
                    kept, step = kept[::2], 2 * step
    except (FFmpegError, IndexError, ValueError) as error:
        raise _refuse(path, str(error).split(":")[0] or type(error).__name__) from None
    if not kept:
        raise _refuse(path, "no frame of it can be decoded")
    chosen = range(min(most, len(kept)))
    return [kept[i * len(kept) // len(chosen)] for i in chosen]


def _turn_upright(frame: Any) -> Image.Image:
    """A frame as it is meant to be seen: telephones store how they were held."""
    return frame.to_image().rotate(frame.rotation, expand=True)


def shrink(frame: Image.Image) -> Image.Image:
    """A frame of at most `MOST_SIDE` pixels a side, by means over whole pixels."""
    factor = -(-max(frame.size) // MOST_SIDE)
    if factor == 1:
        return frame
    if frame.mode != "RGB" or "transparency" in frame.info:
        frame = frame.convert("RGBA")
    return frame.reduce(factor)


def _refuse(path, reason):
    return ValueError(
        f"Expected a readable video in {path}, but it is damaged or of another kind "
        f"({reason}); save it again as MP4, or give a folder of its frames."
    )
