"""Checks of a rendered data set before training: arrays, and poses by their masks.

The masks of all views of an object must agree on a body, which a block is carved into.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from dpc_jax.data.arrays import DataSet
from dpc_jax.evaluation.chamfer import find_rows
from dpc_jax.evaluation.rotations import to_rotation

SMALL, FULL = 0.005, 0.98  # shares of the image that useful masks lie between
FILLED = 0.95  # share of masks that hulls fill: 0.97 for poses that are 4 degrees off
NAMED = 5  # offenders that a finding names
TRIED_VIEWS = 64  # of a set, that hulls are carved of
HULL_REACH, HULL_CELLS = 0.55, 40  # half side and cells a side of a carved block
CONVENTION = "wxyz, object to camera (x right, y down, z forward), object with z up"


class Lens(NamedTuple):
    """The camera of a data set."""

    focal_length: float
    distance: float


def check_set(data: DataSet, lens: Lens) -> list[str]:
    """What is wrong with a data set, each beginning with "error: " or "warning: "."""
    found, findings = {}, []
    for model, name in enumerate(data.names):
        for level, kind, views in _check_model(data, lens, model):
            places = [f"{name} view {view}" for view in np.flatnonzero(views)]
            found.setdefault((level, kind), []).extend(places)
    for (level, kind), places in sorted(found.items()):
        what = f"{int(np.sum(data.counts))} views with {kind}"
        if places:
            findings.append(f"{level}: {len(places)} of {what}: {_name(places)}")
    pairs = zip(data.names, data.counts, strict=True)
    if single := [name for name, count in pairs if count < 2]:
        what = f"{len(data.names)} objects have fewer than two views"
        findings.append(f"warning: {len(single)} of {what}: {_name(single)}")
    findings += _check_hulls(data, lens)
    if lost := [name for name, _ in data.skipped]:
        what = f"{len(lost)} of {len(data.names) + len(lost)} objects left out"
        findings.append(f"warning: {what} as unusable: {_name(lost)}; show tells why")
    return findings


def _name(places):
    """The first of some places as text, and how many more there are."""
    more = len(places) - NAMED
    return ", ".join(places[:NAMED]) + (f" and {more} more" if more > 0 else "")


def _check_model(data, lens, model):
    """(level, fault, which views have it) of all that can be wrong with a view."""
    masks, images = data.rows("masks", model), data.rows("images", model)
    share = masks.mean(axis=(1, 2)) / 255.0
    small = (share > 0) & (share < SMALL)
    yield "error", "an empty mask", share == 0
    yield "warning", f"a mask below {SMALL:.1%} of the image", small
    yield "error", "a mask that fills the image", share > FULL
    covered = masks > 127
    cut = covered[:, [0, -1]].any((1, 2)) | covered[:, :, [0, -1]].any((1, 2))
    yield "error", "an object cut by the frame", cut & (share <= FULL)
    inside = masks == 255
    blank = ((images.min(axis=-1) == 255) | ~inside).all((1, 2)) & inside.any((1, 2))
    yield "warning", "an object as white as its background", blank
    if data.depths is not None:
        depths = data.rows("depths", model)
        missing = covered & (depths <= 0)
        yield "error", "no depth where the mask is covered", missing.any((1, 2))
        # a shape of box diagonal 1 reaches half of it to both sides
        off = covered & (depths > 0) & (abs(depths - lens.distance) > 0.55)
        yield "error", "depth beyond where the object is", off.any((1, 2))


def _check_hulls(data, lens):
    """Whether the masks of an object agree on a body, for some objects of the set.

    A body fills them all if the views agree, even if all are wrong in the same way.
    """
    usable = list_carvable(data)
    count = min(len(usable), max(1, TRIED_VIEWS // int(np.max(data.counts))))
    tried = [usable[row] for row in find_rows(len(usable), count)]
    strays = [
        f"{data.names[model]} ({share:.0%} of the masks agree)"
        for model in tried
        if (share := _fill_masks(data, model, lens)) < FILLED
    ]
    if not strays:
        return []
    what = f"{len(strays)} of {count} objects that were tried"
    return [
        f"error: {what} have poses that do not fit their masks: {_name(strays)}; "
        f"expected is {CONVENTION}; check scale, centre and camera, too"
    ]


def list_carvable(data: DataSet) -> list[int]:
    """Models whose poses can be compared with their masks: of three views and more.

    There are none where views have a lens or place of their own, and none without
    poses.
    """
    cameras = data.translations, data.focal_lengths
    if data.quaternions is None or any(own is not None for own in cameras):
        return []
    return [
        model
        for model in range(len(data.names))
        if data.counts[model] >= 3 and data.rows("masks", model).any((1, 2)).all()
    ]


def _fill_masks(data, model, lens):
    """Share of an object's masks that the block carved by them fills."""
    rotations = to_rotation(data.rows("quaternions", model)).as_matrix()
    masks = data.rows("masks", model)
    # So coarse that no gaps show between the points of the block.
    size, side = masks.shape[-1], HULL_CELLS // 2
    # A pixel may show little of what is thin.
    points = _carve_block(rotations, masks > 25, lens)
    rows, columns, inside = _find_cells(points, rotations, side, lens)
    view = np.broadcast_to(np.arange(len(masks))[:, None], inside.shape)
    ours, theirs = np.zeros((2, len(masks), side, side), bool)
    ours[view[inside], rows[inside], columns[inside]] = True
    view, rows, columns = np.nonzero(masks > 127)
    theirs[view, rows * side // size, columns * side // size] = True
    whole = np.maximum(theirs.sum(axis=(1, 2)), 1)
    return ((ours & theirs).sum(axis=(1, 2)) / whole).mean()


def _carve_block(rotations, masks, lens):
    """Points [P, 3] of a grid that all masks of an object cover (its visual hull).

    With right poses it is a body a little larger than the object; with wrong ones the
    masks of different views leave little of it. Masks are grown by a thirtieth of the
    image, because own images are not centred better than that.
    """
    side = masks.shape[-1]
    width = 2 * max(1, side // 30) + 1
    grown = ndimage.maximum_filter(masks, (1, width, width), mode="constant")
    masks = np.asarray(grown)
    axis = np.linspace(-HULL_REACH, HULL_REACH, HULL_CELLS)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    for rotation, mask in zip(rotations, masks, strict=True):
        rows, columns, inside = _find_cells(points, rotation[None], side, lens)
        points = points[inside[0] & mask[rows[0], columns[0]]]
    return points


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
    cells = np.clip(cells, 0, side - 1).astype(int)
    return cells[..., 1], cells[..., 0], inside
