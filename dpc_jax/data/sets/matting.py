"""Masks by a network of the library rembg, where its weights are on the disk.

An extra: `pip install "dpc_jax[masks]"`. Nothing is downloaded here.
"""

import os
from typing import Any

import numpy as np
from PIL import Image

# Of general objects, the best first, whose weights are free to use.
MODELS = ("birefnet-general", "isnet-general-use", "u2net", "silueta", "u2netp")
_ADDRESS = "https://github.com/danielgatis/rembg/releases/tag/v0.0.0"


def open_session() -> Any:
    """A session of the best of MODELS whose weights are there.

    Raises:
      ValueError: where rembg is not installed, or none of the weights is on the disk.
    """
    try:
        from rembg import new_session  # pyright: ignore
        from rembg.sessions import sessions_class  # pyright: ignore
    except ImportError as error:
        raise ValueError(
            "Expected the library rembg for --mask=matting, but it cannot be loaded "
            f'({error}); install it with: pip install "dpc_jax[masks]".'
        ) from None
    known = {one.name(): one for one in sessions_class}
    for name in (name for name in MODELS if name in known):
        if known[name].resolve_existing(f"{name}.onnx") is not None:
            return new_session(name)
    place = known["u2net"].model_dir() if "u2net" in known else os.path.expanduser("~")
    raise ValueError(
        "Expected the weights of a matting network on this disk, but there are none "
        f"and nothing is downloaded here; put u2net.onnx of {_ADDRESS} into {place}."
    )


def find_object(colors: np.ndarray, session: Any) -> np.ndarray:
    """The mask float32 [height, width] of 0 to 1 of an image uint8 [height, width, 3].

    Args:
      session: of `open_session`.
    """
    from rembg import remove  # pyright: ignore

    mask = remove(Image.fromarray(colors), session=session, only_mask=True)
    return np.asarray(mask.convert("L"), np.float32) / 255.0
