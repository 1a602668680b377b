"""What a data set has in memory, whichever source it comes from."""

from typing import Any, NamedTuple

import numpy as np

ARRAYS = ("images", "masks", "depths", "quaternions", "surfaces")
SEEN = "seen"  # a further array, of surfaces, if asked for
# Further arrays, where views have their own.
CAMERAS = ("translations", "focal_lengths")
CORNERS = ("corner_masks", "corner_depths")  # further arrays, if asked for
# Type and shape of a row of each; S, the image size, is 0 here and may be any.
ROWS: dict[str, tuple[str, tuple[int, ...]]] = {
    "images": ("|u1", (0, 0, 3)),
    "masks": ("|u1", (0, 0)),
    "depths": ("<f4", (0, 0)),
    "quaternions": ("<f4", (4,)),
    "surfaces": ("<f4", (3,)),
    "seen": ("|b1", ()),
    "translations": ("<f4", (3,)),
    "focal_lengths": ("<f4", ()),
    "corner_masks": ("|u1", (0, 0)),
    "corner_depths": ("<f4", (0, 0)),
}


class DataSet(NamedTuple):
    """Views of M models at S pixels; arrays lie on disk and are read when indexed.

    Arrays are `shards.Stack`s, which read like the arrays below, or plain arrays. Where
    models differ in their number of views, V is the largest and `counts` has each.

    images: uint8 [M, V, S, S, 3], on white. masks: uint8 [M, V, S, S], 255 = covered.
    depths: float32 [M, V, S, S], metric z from the camera, 0 where nothing is covered;
        None for own images.
    quaternions: float32 [M, V, 4], wxyz, object to camera; None where not given.
    surfaces: float32 [M, P, 3], points on the surface, for evaluation only; models may
        differ in P; None where there is no ground truth.
    seen: bool [M, P], which of these can be seen from outside; None where not asked.
    translations: float32 [M, V, 3], of the object in the camera frame, after the
        rotation; None where it is not moved or not known.
    focal_lengths: float32 [M, V]; None where all views have the camera's.
    corner_masks: uint8, corner_depths: float32 [M, 8, S, S], as above, of views from
        the corners of a cube (`viewpoints.CORNERS`); None where not asked for.
    names: M names. skipped: (name, reason) of models that could not be used.
    remarks: (name, remark) of models that were used but lack something.
    warnings: sentences on the set as a whole that a reader of results has to know.
    """

    images: Any
    masks: Any
    depths: Any
    quaternions: Any
    surfaces: Any
    names: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]
    remarks: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()
    translations: Any = None
    focal_lengths: Any = None
    corner_masks: Any = None
    corner_depths: Any = None
    seen: Any = None

    @property
    def counts(self) -> np.ndarray:
        """[M] number of views of each model."""
        counts = getattr(self.masks, "counts", None)
        return np.full(*self.masks.shape[:2]) if counts is None else counts

    def rows(self, name: str, model: int) -> np.ndarray:
        """What an array with a row per view has of one model."""
        return np.asarray(getattr(self, name)[model])[: self.counts[model]]
