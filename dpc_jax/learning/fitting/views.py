"""The views of one object that a cloud is fitted to."""

from typing import Any, NamedTuple

import jax
import numpy as np

from dpc_jax.learning.signals import make_targets
from dpc_jax.render import Camera, checks


class Views(NamedTuple):
    """Checked views of one object; what is None was not given.

    Attributes:
      masks: uint8 [V, S, S], share of the pixel that the object covers, times 255.
      depths: [V, S, S], metric z of what the mask covers, 0 where not measured.
      images: uint8 [V, S, S, 3], on white.
    """

    masks: np.ndarray
    depths: np.ndarray | None = None
    images: np.ndarray | None = None

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """What there is, by the names of `make_targets`."""
        return {name: a for name, a in self._asdict().items() if a is not None}


def check_views(silhouettes: Any, depths: Any = None, colors: Any = None) -> Views:
    """The views as arrays; see `fit` for what they may be.

    Raises:
      ValueError: for a wrong shape, values out of range, or an empty silhouette.
    """
    masks = np.asarray(silhouettes)
    side = masks.shape[-1] if masks.ndim else 0
    if masks.ndim != 3 or masks.shape[1] != side or not masks.size:
        raise ValueError(
            "silhouettes must be square images [V, S, S], but their shape is "
            f"{list(masks.shape)}; stack one image for each view."
        )
    masks = _to_bytes("silhouettes", masks)
    empty = np.flatnonzero(masks.reshape(len(masks), -1).max(axis=1) < 128)
    if len(empty):
        raise ValueError(
            "silhouettes must show the object in every view, but no pixel of view "
            f"{empty[0]} is covered by half or more; leave such views out."
        )
    if depths is not None:
        depths = checks.check_real("depths", depths, masks.shape)
        depths = np.asarray(depths, np.float32)
        if not (np.isfinite(depths) & (depths >= 0)).all():
            raise ValueError(
                "depths must be finite and at least 0 (0: not measured), but some are "
                "not; replace those by 0."
            )
    if colors is not None:
        colors = np.asarray(colors)
        if colors.shape != (*masks.shape, 3):
            raise ValueError(
                f"colors must be RGB images {[*masks.shape, 3]} like the silhouettes, "
                f"but their shape is {list(colors.shape)}; give one image of three "
                "channels for each view."
            )
        colors = _to_bytes("colors", colors)
    return Views(masks, depths, colors)


def _to_bytes(name, values) -> np.ndarray:
    if values.dtype == np.uint8:
        return values
    values = values.astype(np.float32)
    if not ((values >= 0) & (values <= 1)).all():  # NaN is neither
        raise ValueError(
            f"{name} must lie between 0 and 1, or be bytes of 0 to 255, but they reach "
            f"from {values.min():.3g} to {values.max():.3g}; divide them by their "
            "largest value."
        )
    return np.round(255 * values).astype(np.uint8)


def list_targets(
    views: Views, side: int, *, signals: tuple[str, ...], camera: Camera
) -> dict[str, jax.Array]:
    """`make_targets` of all views; silhouettes in any case."""
    names = tuple(dict.fromkeys(("silhouette", *signals)))
    return make_targets(
        views.arrays, side, signals=names, distance=float(camera.distance)
    )
