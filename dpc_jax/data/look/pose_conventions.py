"""Which convention poses follow: tried out on silhouettes.

A pose of a data set is a quaternion wxyz that rotates the object (z up, front +x, left
+y) to the camera (x right, y down, z forward). Poses that were made for other
conventions put the object's points elsewhere; undoing each of the usual mistakes tells
which it was.
"""

from typing import NamedTuple

import numpy as np

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
    """How a right rotation follows from stored numbers.

    The quaternion is read as wxyz or xyzw, turned round where it is the inverse, and
    multiplied by matrices [3, 3] on the camera's (left) and the object's side (right).
    """

    name: str
    last: bool = False
    inverse: bool = False
    camera: np.ndarray = np.eye(3)
    object: np.ndarray = np.eye(3)


STORED = Convention("wxyz, object to camera, x right, y down, z forward")
OTHERS = (
    Convention("the inverse, camera to object", inverse=True),
    Convention("the order xyzw", last=True),
    Convention("the order xyzw of the inverse", last=True, inverse=True),
    Convention("cameras with y up and z backward (OpenGL)", camera=FLIP),
    Convention(
        "camera to object, y up and z backward (NeRF)", inverse=True, camera=FLIP
    ),
    Convention("xyzw, y up and z backward (OpenGL)", last=True, camera=FLIP),
    Convention(
        "xyzw, camera to object, y up and z backward (NeRF)",
        last=True,
        inverse=True,
        camera=FLIP,
    ),
    Convention(
        "cameras with the axes depth, up, right (the paper's code)",
        camera=DEPTH_UP_RIGHT,
    ),
    *(
        Convention(f"objects with y up and front {front}", object=turn)
        for front, turn in Y_UP.items()
    ),
    *(
        Convention(
            f"objects with y up and front {front}, y up and z backward (OpenGL)",
            camera=FLIP,
            object=turn,
        )
        for front, turn in Y_UP.items()
    ),
    Convention("objects with their front at -x", object=np.diag([-1.0, -1, 1])),
    Convention("objects with their front at +y", object=QUARTER),
    Convention("objects with their front at -y", object=QUARTER.T),
    Convention("images mirrored left to right", camera=np.diag([-1.0, 1, 1])),
    Convention("images upside down", camera=np.diag([1.0, -1, 1])),
)


def rotation_of(quaternions, convention=STORED):
    """Rotation matrices [..., 3, 3] of stored quaternions [..., 4] of any length.

    They are NaN where a quaternion is not finite.
    """
    q = np.asarray(quaternions, dtype=np.float64)
    q = np.where(np.isfinite(q).all(axis=-1, keepdims=True), q, np.nan)
    q = q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-30)
    if convention.last:
        q = np.roll(q, 1, axis=-1)
    w, v = q[..., :1, None], q[..., 1:]
    cross = np.cross(v[..., None, :], -np.eye(3))  # rows: the matrix of v x
    turn = np.eye(3) + 2.0 * (w * cross + cross @ cross)
    if convention.inverse:
        turn = np.swapaxes(turn, -1, -2)
    return convention.camera @ turn @ convention.object


def project_points(points, rotations, lens):
    """Places of points in images.

    Args:
      points: [P, 3] object frame. rotations: [V, 3, 3]. lens: `Lens`.

    Returns:
      ([V, P, 2] x and y in shares of the image's side, [V, P] metric z); a point at or
      behind the camera is far outside.
    """
    back = np.ascontiguousarray(np.swapaxes(rotations, -1, -2))  # ten times as fast
    seen = np.asarray(points, dtype=np.float64) @ back
    depth = seen[..., 2] + lens.distance
    safe = np.where(depth > 1e-6, depth, 1.0)
    place = seen[..., :2] / safe[..., None] * (lens.focal_length / lens.extent) + 0.5
    return np.where((depth > 1e-6)[..., None], place, 9.0), depth


def mark_points(places, side):
    """Boolean images [V, side, side] of the cells that points [V, P, 2] fall into."""
    cells = np.floor(places * side).astype(int)
    inside = ((cells >= 0) & (cells < side)).all(axis=-1)
    view = np.broadcast_to(np.arange(len(places))[:, None], inside.shape)
    marks = np.zeros((len(places), side, side), dtype=bool)
    marks[view[inside], cells[inside][:, 1], cells[inside][:, 0]] = True
    return marks


def shrink_masks(masks, side):
    """Boolean images [V, side, side]: cells that masks [V, S, S] touch."""
    view, row, column = np.nonzero(masks)
    size = masks.shape[-1]
    small = np.zeros((len(masks), side, side), dtype=bool)
    small[view, row * side // size, column * side // size] = True
    return small


def grow_masks(masks, cells):
    """Boolean masks [V, S, S] grown by so many cells to all eight sides."""
    for _ in range(cells):
        padded = np.pad(masks, ((0, 0), (1, 1), (1, 1)))
        masks = padded[:, :-2] | padded[:, 1:-1] | padded[:, 2:]
        masks = masks[..., :-2] | masks[..., 1:-1] | masks[..., 2:]
    return masks


def compare_silhouettes(points, rotations, masks, lens):
    """Intersection over union [V] of points' cells and the cells that masks touch.

    Args:
      points: [P, 3], on the surface. rotations: [V, 3, 3]. masks: [V, S, S].
    """
    side = min(masks.shape[-1], GRID if len(points) >= POINTS else GRID // 2)
    places, _ = project_points(points, rotations, lens)
    ours, theirs = mark_points(places, side), shrink_masks(masks, side)
    both = (ours & theirs).sum(axis=(1, 2))
    return both / np.maximum((ours | theirs).sum(axis=(1, 2)), 1)


def carve_hull(rotations, masks, lens):
    """Points [P, 3] of a grid that all masks of an object cover (its visual hull).

    Where poses are right that is a body a little larger than the object; where they
    are wrong, the masks of different views leave little of it. Masks are grown by
    a thirtieth of the image, because own images are centred only so well.
    """
    side = masks.shape[-1]
    masks = grow_masks(masks > 127, max(1, side // 30))
    axis = np.linspace(-HULL_REACH, HULL_REACH, HULL_CELLS)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    for rotation, mask in zip(rotations, masks, strict=True):
        places, _ = project_points(points, rotation[None], lens)
        cells = np.floor(places[0] * side).astype(int)
        inside = ((cells >= 0) & (cells < side)).all(axis=-1)
        points, cells = points[inside], cells[inside]
        points = points[mask[cells[:, 1], cells[:, 0]]]
    return points


def score_convention(convention, quaternions, masks, surface, lens):
    """How well an object's poses fit its masks under a convention, from 0 to 1.

    With a surface it is the mean intersection over union of the silhouettes. Without,
    it is the share of the masks that the visual hull fills: 1 where views agree, also
    where all of them are wrong in the same way.

    Args:
      quaternions: [V, 4] as stored. masks: uint8 [V, S, S].
      surface: [P, 3] points on the surface, or None.
    """
    rotations = rotation_of(quaternions, convention)
    if surface is not None:
        return float(compare_silhouettes(surface, rotations, masks, lens).mean())
    hull = carve_hull(rotations, masks, lens)
    side = HULL_CELLS // 2  # so coarse that points of the hull leave no gaps
    places, _ = project_points(hull, rotations, lens)
    ours, theirs = mark_points(places, side), shrink_masks(masks > 127, side)
    filled = (ours & theirs).sum(axis=(1, 2)) / np.maximum(theirs.sum(axis=(1, 2)), 1)
    return float(filled.mean())
