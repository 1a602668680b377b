"""What a data set has in memory, whichever source it comes from."""

import mmap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

CORNERS = ("corner_masks", "corner_depths")  # arrays with a row per corner of a cube
# Type and shape of a row of each array; S, the image size, is 0 here and may be any.
ROWS: dict[str, tuple[str, tuple[int, ...]]] = {
    "images": ("|u1", (0, 0, 3)),
    "masks": ("|u1", (0, 0)),
    "depths": ("<f4", (0, 0)),
    "quaternions": ("<f4", (4,)),
    "surfaces": ("<f4", (3,)),
    "visible": ("<u2", (3,)),
    "translations": ("<f4", (3,)),
    "focal_lengths": ("<f4", ()),
    "corner_masks": ("|u1", (0, 0)),
    "corner_depths": ("<f4", (0, 0)),
}
VISIBLE_STEPS = 65_535  # of coordinates from -0.5 to 0.5: half the bytes, 1e-5 apart
KEPT_PAGES = 32 << 20  # bytes read before mapped pages are given back to the system


class DataSet(NamedTuple):
    """Rendered views of M models; views and surfaces refer to the same object frame.

    Arrays are `Stack`s, which read like the arrays below, or plain arrays. Where models
    differ in their number of views, V is the largest and `counts` has each.

    images: uint8 [M, V, S, S, 3], on white. masks: uint8 [M, V, S, S], 255 = covered.
    depths: float32 [M, V, S, S], metric z from the camera, 0 where nothing is covered;
        None for own images.
    quaternions: float32 [M, V, 4], wxyz, object to camera; None where not given.
    surfaces: float32 [M, P, 3], points on the surface, for evaluation only; models may
        differ in P; None where there is no ground truth.
    visible: uint16 [M, P, 3], points that can be seen from outside, see `read_visible`;
        None where not asked.
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
    visible: Any = None

    @property
    def counts(self) -> np.ndarray:
        """[M] number of views of each model."""
        counts = getattr(self.masks, "counts", None)
        return np.full(*self.masks.shape[:2]) if counts is None else counts

    def rows(self, name: str, model: int) -> np.ndarray:
        """What an array with a row per view has of one model."""
        return np.asarray(getattr(self, name)[model])[: self.counts[model]]

    def take(self, count: int) -> "DataSet":
        """The first models, at most so many."""
        names = self.names[:count]
        arrays = {
            field: Stack([rows[model] for model in range(len(names))])
            for field, rows in self._asdict().items()
            if not isinstance(rows, tuple | None)
        }
        return self._replace(names=names, **arrays)

    def read_visible(self, model: int) -> np.ndarray:
        """Points [P, 3] float64 of a model's surface that can be seen from outside."""
        return np.asarray(self.visible[model]) / VISIBLE_STEPS - 0.5


class Pages:
    """Releases mapped pages after enough has been read, so that memory stays small.

    The system would keep them as long as it has room, and would count a process that
    has read 3 GB as 3 GB larger. A page that is wanted again comes from the file cache.
    """

    def __init__(self, mappings: Sequence[mmap.mmap] = ()):
        self._mappings = mappings
        self._read = 0

    def count(self, size: int):
        """Note that `size` bytes were read."""
        self._read += size
        if self._read > KEPT_PAGES:
            self._read = 0
            for mapping in self._mappings:
                mapping.madvise(mmap.MADV_DONTNEED)


class Stack:
    """Rows of many models, wherever they lie, addressed by model and row.

    It reads like an array [M, V, ...] of which model m has only `counts[m]` rows:
    `stack[m]` is an array [counts[m], ...], `stack[m, v]` one row, and
    `stack[models, rows]` gathers rows into memory, for index arrays of like shapes.
    `shape[1]` is the largest count. Where all counts agree, other indices and
    `np.asarray` work too, by reading the whole into memory.
    """

    def __init__(self, models: Sequence[np.ndarray], pages: Pages | None = None):
        """models: the rows [counts[m], ...] of each, mapped or in memory."""
        self._models, self._pages = models, pages or Pages()
        self.counts = np.array([len(rows) for rows in models], dtype=np.int64)
        self.shape = (len(models), int(self.counts.max()), *models[0].shape[1:])
        self.dtype = models[0].dtype

    def __len__(self):
        return len(self._models)

    def __iter__(self):
        return (self._read_model(model) for model in range(len(self)))

    def __getitem__(self, key):
        model, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(model, int | np.integer):
            return self._read_model(model)[tuple(rest)]
        if isinstance(key, tuple) and len(key) == 2:
            first, second = (np.asarray(part) for part in key)
            if first.dtype.kind in "iu" and second.dtype.kind in "iu":
                return self._gather(first, second)
        return np.asarray(self)[key]

    def __array__(self, dtype=None, copy=None):
        if (self.counts != self.shape[1]).any():
            raise ValueError(
                "Expected models with equal numbers of rows, but they have "
                f"{self.counts.min()} to {self.counts.max()}; read them one by one."
            )
        return np.stack(list(self)).astype(dtype or self.dtype, copy=False)

    def _read_model(self, model):
        rows = self._models[model]
        self._pages.count(rows.nbytes)
        return rows

    def _gather(self, models, rows):
        models, rows = np.broadcast_arrays(models, rows)
        if min(models.min(), rows.min()) < 0 or (rows >= self.counts[models]).any():
            raise IndexError("a model or a row beyond the last, or below 0")
        out = np.empty((*models.shape, *self.shape[2:]), self.dtype)
        for place in np.ndindex(models.shape):
            out[place] = self._models[int(models[place])][rows[place]]
        self._pages.count(out.nbytes)
        return out
