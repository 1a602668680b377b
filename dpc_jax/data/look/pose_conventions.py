"""Which convention poses follow: tried out on silhouettes.

Poses made for another convention than ours put the object's points elsewhere; undoing
each of the usual mistakes in turn shows which one it was.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

GRID = 64  # silhouettes are compared on at most this many cells a side
POINTS = 5000  # of a surface that are compared
HULL_REACH, HULL_CELLS = 0.55, 40  # half side and cells a side of a carved hull

FLIP = np.diag([1.0, -1.0, -1.0])  # between a camera with y up, z back and ours
Y_UP = {  # to objects with y up, by what faces front there: rows are their axes
    "+z": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-z": np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]),
    "+x": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # front +x to +y
DEPTH_UP_RIGHT = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])


class Lens(NamedTuple):
    """The camera of a data set: of an image plane `extent` wide."""

    focal_length: float
    distance: float
    extent: float


class Convention(NamedTuple):
    """How the right rotation follows from the stored numbers.

    The quaternion is read as wxyz, or as xyzw if the real part comes last; it is
    inverted if it is the inverse, and multiplied by matrices [3, 3] on the left for the
    camera's axes and on the right for the object's.
    """

    name: str
    last: bool = False
    inverse: bool = False
    camera: np.ndarray = np.eye(3)
    object: np.ndarray = np.eye(3)


NERF: dict[str, Any] = {"inverse": True, "camera": FLIP}
STORED = Convention("wxyz, object to camera, x right, y down, z forward")
OTHERS = (
    Convention("the inverse, camera to object", inverse=True),
    Convention("the order xyzw", last=True),
    Convention("the order xyzw of the inverse", last=True, inverse=True),
    Convention("cameras with y up and z backward (OpenGL)", camera=FLIP),
    Convention("camera to object, y up and z backward (NeRF)", **NERF),
    Convention("xyzw, y up and z backward (OpenGL)", last=True, camera=FLIP),
    Convention("xyzw, camera to object, y up and z backward (NeRF)", last=True, **NERF),
    Convention(
        "cameras with the axes depth, up, right (the paper's code)",
        camera=DEPTH_UP_RIGHT,
    ),
    *(
        Convention(
            f"objects with y up and front {front}{more}", camera=flip, object=turn
        )
        for more, flip in (("", np.eye(3)), (", y up and z backward (OpenGL)", FLIP))
        for front, turn in Y_UP.items()
    ),
    Convention("objects with their front at -x", object=np.diag([-1.0, -1, 1])),
    Convention("objects with their front at +y", object=QUARTER),
    Convention("objects with their front at -y", object=QUARTER.T),
    Convention("images mirrored left to right", camera=np.diag([-1.0, 1, 1])),
    Convention("images upside down", camera=np.diag([1.0, -1, 1])),
)


def rotation_of(quaternions: np.ndarray, convention: Convention = STORED) -> np.ndarray:
    """Rotation matrices [..., 3, 3] of stored quaternions [..., 4] of any length.

    They are NaN where a quaternion is not finite, and the identity where it is zero.
    """
    q = np.asarray(quaternions, dtype=np.float64)
    finite = np.all(np.isfinite(q), axis=-1, keepdims=True)
    identity = np.roll([1.0, 0, 0, 0], -1 if convention.last else 0)
    q = np.where(finite & q.any(axis=-1, keepdims=True), q, identity)
    # The squares of extreme components would overflow or vanish.
    q = q / np.abs(q).max(axis=-1, keepdims=True)
    turns = Rotation.from_quat(q, scalar_first=not convention.last)
    turns = (turns.inv() if convention.inverse else turns).as_matrix()
    turns = np.where(finite[..., None], turns, np.nan)
    return convention.camera @ turns @ convention.object


def project_points(
    points: np.ndarray, rotations: np.ndarray, lens: Lens
) -> tuple[np.ndarray, np.ndarray]:
    """Places of points [P, 3] in images by rotations [V, 3, 3], and their depths.

    Places [V, P, 2] are x and y in shares of the image's side, depths [V, P] metric z;
    a point at or behind the camera is far outside.
    """
    back = np.ascontiguousarray(np.swapaxes(rotations, -1, -2))  # ten times as fast
    seen = np.asarray(points, dtype=np.float64) @ back
    depth = seen[..., 2] + lens.distance
    safe = np.where(depth > 1e-6, depth, 1.0)
    place = seen[..., :2] / safe[..., None] * (lens.focal_length / lens.extent) + 0.5
    return np.where((depth > 1e-6)[..., None], place, 9.0), depth


def find_cells(places: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column [2, ...] of the cells that places [..., 2] of a grid fall into.

    Places are x and y in shares of the image's side; a point outside of the image gets
    the nearest cell. The second array tells whether a point is inside.
    """
    cells = np.floor(places * side)
    inside = np.all((cells >= 0) & (cells < side), axis=-1)
    cells = np.clip(np.nan_to_num(cells, nan=-1), 0, side - 1).astype(int)
    return np.moveaxis(cells[..., ::-1], -1, 0), inside


def _mark_points(places, side):
    """Boolean images [V, side, side] of the cells that points [V, P, 2] fall into."""
    (rows, columns), inside = find_cells(places, side)
    view = np.broadcast_to(np.arange(len(places))[:, None], inside.shape)
    marks = np.zeros((len(places), side, side), dtype=bool)
    marks[view[inside], rows[inside], columns[inside]] = True
    return marks


def _shrink_masks(masks, side):
    """Boolean images [V, side, side] of the cells that masks [V, S, S] touch."""
    view, row, column = np.nonzero(masks)
    size = masks.shape[-1]
    small = np.zeros((len(masks), side, side), dtype=bool)
    small[view, row * side // size, column * side // size] = True
    return small


def grow_masks(masks: np.ndarray, cells: int) -> np.ndarray:
    """Boolean masks [V, S, S], grown by a number of cells in all eight directions."""
    width = 2 * cells + 1
    return ndimage.maximum_filter(masks, (1, width, width), mode="constant")


def _compare_cells(points, rotations, masks, lens, *, side):
    """Cells [V] that points and masks share, that masks touch, and that either does."""
    places, _ = project_points(points, rotations, lens)
    ours, theirs = _mark_points(places, side), _shrink_masks(masks, side)
    both, either = ours & theirs, ours | theirs
    return [cells.sum(axis=(1, 2)) for cells in (both, theirs, either)]


def _carve_hull(rotations, masks, lens):
    """Points [P, 3] of a grid that all masks of an object cover (its visual hull).

    With right poses it is a body a little larger than the object; with wrong ones the
    masks of different views leave little of it. Masks are grown by a thirtieth of the
    image, because own images are not centred better than that.
    """
    side = masks.shape[-1]
    masks = grow_masks(masks > 127, max(1, side // 30))
    axis = np.linspace(-HULL_REACH, HULL_REACH, HULL_CELLS)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    for rotation, mask in zip(rotations, masks, strict=True):
        places, _ = project_points(points, rotation[None], lens)
        (rows, columns), inside = find_cells(places[0], side)
        points = points[inside & mask[rows, columns]]
    return points


def score_convention(
    convention: Convention,
    quaternions: np.ndarray,
    masks: np.ndarray,
    surface: np.ndarray | None,
    lens: Lens,
) -> float:
    """How well an object's poses [V, 4] fit its masks under a convention, from 0 to 1.

    With a surface [P, 3] it is the mean intersection over union of the silhouettes.
    Without one it is the share of the masks that the visual hull fills: 1 if the views
    agree, even if all of them are wrong in the same way.
    """
    rotations = rotation_of(quaternions, convention)
    if surface is not None:
        side = min(masks.shape[-1], GRID if len(surface) >= POINTS else GRID // 2)
        both, _, either = _compare_cells(surface, rotations, masks, lens, side=side)
        return float((both / np.maximum(either, 1)).mean())
    hull = _carve_hull(rotations, masks, lens)
    side = HULL_CELLS // 2  # coarse enough for the hull's points to leave no gaps
    both, theirs, _ = _compare_cells(hull, rotations, masks > 127, lens, side=side)
    return float((both / np.maximum(theirs, 1)).mean())
