"""Checks of a rendered data set before training: arrays, and poses by their masks.

Poses must put an object where its masks are: its surface points or, without those, a
block that the masks of all its views carve out. Poses that do not are tried under the
usual other conventions, and the one that fits is named.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from dpc_jax.data.arrays import DataSet

SMALL, FULL = 0.005, 0.98  # shares of the image that useful masks lie between
LENGTH_FLAW = 1e-3  # of a unit quaternion
WHITE = 250  # darkest mean background that passes for white
FIT = 0.85  # intersection over union of right poses: 0.92 and above on real meshes
FILLED = 0.95  # share of masks that hulls fill: 0.98 and above for right poses
STRAY = 0.9  # share of a surface inside its own mask: above 0.99 for right poses
CLEARER = 0.02  # by which another convention must fit better
NAMED = 5  # offenders that a finding names
TRIED_VIEWS, TRIED_POINTS = 64, 10_000  # that conventions are tried on
GRID = 64  # most cells a side that silhouettes of so many points are compared on
HULL_REACH, HULL_CELLS = 0.55, 40  # half side and cells a side of a carved block


class Lens(NamedTuple):
    """The camera of a data set."""

    focal_length: float
    distance: float


class Convention(NamedTuple):
    """How the right rotation follows from the stored numbers.

    The quaternion is read as wxyz, or as xyzw if the real part comes last; it is
    inverted if it is the inverse, and multiplied by matrices [3, 3] on the left for the
    camera's axes and on the right for the object's.
    """

    last: bool = False
    inverse: bool = False
    camera: np.ndarray = np.eye(3)
    object: np.ndarray = np.eye(3)


STILL = np.eye(3)
FLIP = np.diag([1.0, -1.0, -1.0])  # between a camera with y up, z back and ours
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # front +x to +y
Y_UP = {  # to objects with y up, by what faces front there: rows are their axes
    "+z": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-z": np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]),
    "+x": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
STORED = Convention()
OTHERS = {
    "the inverse, camera to object": Convention(inverse=True),
    "the order xyzw": Convention(last=True),
    "the order xyzw of the inverse": Convention(True, True),
    "cameras with y up and z backward (OpenGL)": Convention(camera=FLIP),
    "camera to object, y up and z backward (NeRF)": Convention(False, True, FLIP),
    "xyzw, y up and z backward (OpenGL)": Convention(True, False, FLIP),
    "xyzw, camera to object, y up and z backward (NeRF)": Convention(True, True, FLIP),
    "cameras with the axes depth, up, right (the paper's code)": Convention(
        camera=np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    ),
    **{
        f"objects with y up and front {front}{more}": Convention(False, False, flip, up)
        for more, flip in (("", STILL), (", y up and z backward (OpenGL)", FLIP))
        for front, up in Y_UP.items()
    },
    "objects with their front at -x": Convention(object=np.diag([-1.0, -1, 1])),
    "objects with their front at +y": Convention(object=QUARTER),
    "objects with their front at -y": Convention(object=QUARTER.T),
    "images mirrored left to right": Convention(camera=np.diag([-1.0, 1, 1])),
    "images upside down": Convention(camera=np.diag([1.0, -1, 1])),
}


def check_set(data: DataSet, lens: Lens) -> list[str]:
    """What is wrong with a data set, each beginning with "error: " or "warning: "."""
    found, findings = {}, []
    for model, name in enumerate(data.names):
        for level, kind, views in _check_model(data, lens, model):
            places = [f"{name} view {view}" for view in np.flatnonzero(views)]
            places = [name] if kind.startswith("have ") else places
            found.setdefault((level, kind), []).extend(places)
    for (level, kind), places in sorted(found.items()):
        what = f"{int(np.sum(data.counts))} views with {kind}"
        if kind.startswith("have "):
            what = f"{len(data.names)} objects {kind}"
        if places:
            findings.append(f"{level}: {len(places)} of {what}: {_name(places)}")
    findings += _check_poses(data, lens)
    if lost := [name for name, _ in data.skipped]:
        what = f"{len(lost)} of {len(data.names) + len(lost)} objects left out"
        findings.append(f"warning: {what} as unusable: {_name(lost)}; show tells why")
    return findings


def _name(places):
    """The first of some places as text, and how many more there are."""
    more = len(places) - NAMED
    return ", ".join(places[:NAMED]) + (f" and {more} more" if more > 0 else "")


def _check_model(
    data: DataSet, lens: Lens, model: int
) -> Iterator[tuple[str, str, Any]]:
    """(level, fault, which views have it); what objects "have" is of the whole one."""
    masks, images = data.rows("masks", model), data.rows("images", model)
    if len(masks) < 2:
        yield "warning", "have fewer than two views", None
    share = masks.mean(axis=(1, 2)) / 255.0
    small = (share > 0) & (share < SMALL)
    yield "error", "an empty mask", share == 0
    yield "warning", f"a mask below {SMALL:.1%} of the image", small
    yield "error", "a mask that fills the image", share > FULL
    covered = masks > 127
    cut = covered[:, [0, -1]].any((1, 2)) | covered[:, :, [0, -1]].any((1, 2))
    yield "error", "an object cut by the frame", cut & (share <= FULL)
    outside, inside = masks == 0, masks == 255
    light = (images.mean(axis=-1) * outside).sum((1, 2))
    dark = light < WHITE * outside.sum((1, 2))
    yield "warning", "a background that is not white", dark
    blank = ((images.min(axis=-1) == 255) | ~inside).all((1, 2)) & inside.any((1, 2))
    yield "warning", "an object as white as its background", blank
    if data.depths is not None:
        depths = data.rows("depths", model)
        broken = ~np.isfinite(depths)
        yield "error", "a depth with NaN or infinity", broken.any((1, 2))
        missing = covered & ~broken & (depths <= 0)
        yield "error", "no depth where the mask is covered", missing.any((1, 2))
        # a shape of box diagonal 1 reaches half of it to both sides
        off = covered & (depths > 0) & ~broken & (abs(depths - lens.distance) > 0.55)
        yield "error", "depth beyond where the object is", off.any((1, 2))
    if data.quaternions is not None:
        rows = data.rows("quaternions", model).astype(np.float64)
        broken = ~np.all(np.isfinite(rows), axis=1)
        yield "error", "a quaternion with NaN or infinity", broken
        bent = np.abs(np.linalg.norm(rows, axis=1) - 1.0) > LENGTH_FLAW
        yield "error", "a quaternion that is not of length 1", bent & ~broken
    if data.surfaces is not None:
        points = np.asarray(data.surfaces[model])
        if not np.isfinite(points).all() or len(points) == 0:
            yield "error", "have surface points with NaN or none", None
        elif not 0.5 < np.linalg.norm(np.ptp(points, axis=0)) < 1.1:
            yield "warning", "have surface points whose box diagonal is not 1", None


def _check_poses(data, lens):
    """Whether poses put objects where their masks are."""
    chosen = [] if data.quaternions is None else _choose_models(data)
    if not chosen:
        return []
    others, measure, enough = OTHERS, "overlap with the masks", FIT
    if data.surfaces is None:  # then the object's axes cannot be told apart
        others = {n: c for n, c in OTHERS.items() if np.array_equal(c.object, STILL)}
        measure, enough = "share of the masks that agrees", FILLED
    stored, *scores = (
        np.mean([_score(data, model, convention, lens) for model in chosen])
        for convention in (STORED, *others.values())
    )
    best = max(scores)
    near = np.flatnonzero(np.greater(scores, best - CLEARER / 4))
    names = [list(others)[place] for place in near]
    if best > stored + CLEARER and best >= enough:
        return [
            f"error: the poses follow another convention: {' or '.join(names)} "
            f"({measure} {best:.2f}); as stored, which should be wxyz, object to "
            "camera, x right, y down, z forward, it is "
            f"{stored:.2f}; convert the poses."
        ]
    strays = [] if data.surfaces is None else _find_strays(data, lens)
    count = int(np.sum(data.counts))
    if stored < enough and not 0 < len(strays) < count / 2:
        nearest = f" (the nearest, {names[0]}: {best:.2f})" if best > stored else ""
        return [
            f"error: the poses do not fit the masks ({measure} {stored:.2f}, expected "
            f"{enough} and more) under any convention known here{nearest}; check "
            "scale, centre and camera."
        ]
    text = f"{len(strays)} of {count} views whose pose puts the object beside its mask"
    return [f"error: {text}: {_name(strays)}"] if strays else []


def _choose_models(data):
    """Models to try conventions on, spread over the set."""
    has_surface = data.surfaces is not None
    usable = [
        m
        for m in range(len(data.names))
        if data.counts[m] >= (1 if has_surface else 3)
        and np.isfinite(rotation_of(data.rows("quaternions", m))).all()
        and np.asarray(data.masks[m]).any()
        and not (has_surface and _read_surface(data, m) is None)
    ]
    count = max(1, TRIED_VIEWS // int(max(1, np.max(data.counts))))
    places = np.linspace(0, len(usable) - 1, min(count, len(usable))).round()
    return [usable[int(place)] for place in places]


def _read_surface(data, model, count=TRIED_POINTS):
    """About so many of a model's surface points; None if there are none to be used."""
    points = [] if data.surfaces is None else np.asarray(data.surfaces[model])
    if len(points) == 0 or not np.isfinite(points).all():
        return None
    return points[:: max(1, len(points) // count)]


def _score(data, model, convention, lens):
    """How well an object's poses fit its masks under a convention, from 0 to 1.

    With a surface it is the mean intersection over union of the silhouettes. Without
    one it is the share of the masks that the carved block fills: 1 if the views agree,
    even if all of them are wrong in the same way.
    """
    rotations = rotation_of(data.rows("quaternions", model), convention)
    masks, points = data.rows("masks", model), _read_surface(data, model)
    size, is_carved = masks.shape[-1], points is None
    if points is None:
        masks, side = masks > 127, HULL_CELLS // 2  # so coarse that no gaps show
        points = _carve_block(rotations, masks, lens)
    else:
        side = min(size, GRID if len(points) >= TRIED_POINTS // 2 else GRID // 2)
    rows, columns, inside = _find_cells(points, rotations, side, lens)
    view = np.broadcast_to(np.arange(len(masks))[:, None], inside.shape)
    ours, theirs = np.zeros((2, len(masks), side, side), bool)
    ours[view[inside], rows[inside], columns[inside]] = True
    view, rows, columns = np.nonzero(masks)
    theirs[view, rows * side // size, columns * side // size] = True
    whole = (theirs if is_carved else ours | theirs).sum(axis=(1, 2))
    return float(((ours & theirs).sum(axis=(1, 2)) / np.maximum(whole, 1)).mean())


def _carve_block(rotations, masks, lens):
    """Points [P, 3] of a grid that all masks of an object cover (its visual hull).

    With right poses it is a body a little larger than the object; with wrong ones the
    masks of different views leave little of it. Masks are grown by a thirtieth of the
    image, because own images are not centred better than that.
    """
    side = masks.shape[-1]
    masks = _grow(masks, max(1, side // 30))
    axis = np.linspace(-HULL_REACH, HULL_REACH, HULL_CELLS)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    for rotation, mask in zip(rotations, masks, strict=True):
        rows, columns, inside = _find_cells(points, rotation[None], side, lens)
        points = points[inside[0] & mask[rows[0], columns[0]]]
    return points


def _grow(masks, cells) -> np.ndarray:
    """Boolean masks [V, S, S], grown by a number of cells in all eight directions."""
    width = 2 * cells + 1
    grown = ndimage.maximum_filter(masks, (1, width, width), mode="constant")
    return np.asarray(grown)


def _find_strays(data, lens):
    """Views whose pose puts a tenth of the surface and more beside the mask."""
    strays = []
    for model, name in enumerate(data.names):
        surface = _read_surface(data, model, 1000)
        if surface is None:
            continue
        masks = _grow(data.rows("masks", model) > 0, 1)
        rotations = rotation_of(data.rows("quaternions", model))
        rows, columns, inside = _find_cells(surface, rotations, masks.shape[-1], lens)
        hits = masks[np.arange(len(masks))[:, None], rows, columns] & inside
        seen = np.isfinite(rotations).all(axis=(1, 2))
        usable = np.asarray(masks.any(axis=(1, 2)) & seen)
        strays += [
            f"{name} view {view} ({share:.0%} inside)"
            for view, share in enumerate(hits.mean(axis=1))
            if share < STRAY and usable[view]
        ]
    return strays


def rotation_of(quaternions: np.ndarray, convention: Convention = STORED) -> np.ndarray:
    """Rotation matrices [..., 3, 3] of stored quaternions [..., 4]; NaN for broken."""
    q = np.asarray(quaternions, dtype=np.float64)
    size = np.abs(q).max(axis=-1, keepdims=True)
    broken = ~((size > 1e-9) & (size < 1e9))  # NaN, zero, or squares that overflow
    turns = Rotation.from_quat(
        np.where(broken, 1.0, q), scalar_first=not convention.last
    )
    turns = (turns.inv() if convention.inverse else turns).as_matrix()
    turns = np.where(broken[..., None], np.nan, turns)
    return convention.camera @ turns @ convention.object


def project_points(points: np.ndarray, rotations: np.ndarray, lens: Lens) -> np.ndarray:
    """Places [V, P, 2] of points [P, 3] in images by rotations [V, 3, 3].

    They are x and y in shares of the image's side; a point at or behind the camera is
    far outside.
    """
    back = np.ascontiguousarray(np.swapaxes(rotations, -1, -2))  # ten times as fast
    seen = np.asarray(points, dtype=np.float64) @ back
    depth = seen[..., 2] + lens.distance
    safe = np.where(depth > 1e-6, depth, 1.0)
    place = seen[..., :2] / safe[..., None] * lens.focal_length + 0.5
    return np.where((depth > 1e-6)[..., None], place, 9.0)


def _find_cells(points, rotations, side, lens):
    """Rows and columns [V, P] of the cells that points fall into, and which are inside.

    A point outside of the image gets the nearest cell.
    """
    cells = np.floor(project_points(points, rotations, lens) * side)
    inside = np.all((cells >= 0) & (cells < side), axis=-1)
    cells = np.clip(np.nan_to_num(cells, nan=-1), 0, side - 1).astype(int)
    return cells[..., 1], cells[..., 0], inside
