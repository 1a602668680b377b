"""Checks of a rendered data set before training: arrays, and poses by their masks.

Poses must put an object where its masks are: its surface points or, without those, a
block that the masks of all its views carve out.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from dpc_jax.data.arrays import DataSet
from dpc_jax.evaluation.rotations import to_rotation

SMALL, FULL = 0.005, 0.98  # shares of the image that useful masks lie between
FILLED = 0.95  # share of masks that hulls fill: 0.98 and above for right poses
STRAY = 0.9  # share of a surface inside its own mask: above 0.99 for right poses
NAMED = 5  # offenders that a finding names
TRIED_VIEWS, TRIED_POINTS = 64, 1000  # of a set, that hulls are carved of; of a surface
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


def _check_model(data, lens, model):
    """(level, fault, which views have it); what objects "have" is of the whole one."""
    masks, images = data.rows("masks", model), data.rows("images", model)
    if len(masks) < 2:
        yield "warning", "have fewer than two views", ()
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
    if data.surfaces is not None:
        points = np.asarray(data.surfaces[model])
        if not 0.8 < np.linalg.norm(np.ptp(points, axis=0)) < 1.1:
            yield "warning", "have surface points whose box diagonal is not 1", ()


def _check_poses(data, lens):
    """Whether poses put objects where their masks are."""
    if data.quaternions is None:
        return []
    if data.surfaces is None:
        return _check_hulls(data, lens)
    strays = _find_strays(data, lens)
    if not strays:
        return []
    what = f"{len(strays)} of {int(np.sum(data.counts))} views"
    what += f" whose pose puts the object beside its mask: {_name(strays)}"
    return [f"error: {what}; expected is {CONVENTION}"]


def _find_strays(data, lens):
    """Views whose pose puts a tenth of the surface and more beside the mask."""
    strays = []
    for model, name in enumerate(data.names):
        surface = np.asarray(data.surfaces[model])
        surface = surface[:: max(1, len(surface) // TRIED_POINTS)]
        masks = _grow(data.rows("masks", model) > 0, 1)
        rotations = to_rotation(data.rows("quaternions", model)).as_matrix()
        rows, columns, inside = _find_cells(surface, rotations, masks.shape[-1], lens)
        hits = masks[np.arange(len(masks))[:, None], rows, columns] & inside
        seen = np.asarray(masks.any(axis=(1, 2)))
        strays += [
            f"{name} view {view} ({share:.0%} inside)"
            for view, share in enumerate(hits.mean(axis=1))
            if share < STRAY and seen[view]
        ]
    return strays


def _check_hulls(data, lens):
    """Whether the masks of an object agree on a body, for some objects of the set.

    A body fills them all if the views agree, even if all are wrong in the same way.
    """
    usable = [
        model
        for model in range(len(data.names))
        if data.counts[model] >= 3 and np.asarray(data.masks[model]).any()
    ]
    if not usable:
        return []
    count = min(len(usable), max(1, TRIED_VIEWS // int(np.max(data.counts))))
    places = np.linspace(0, len(usable) - 1, count).round().astype(int)
    filled = np.mean([_fill_masks(data, usable[place], lens) for place in places])
    if filled >= FILLED:
        return []
    return [
        f"error: the poses do not fit the masks, which agree on {filled:.2f} of "
        f"themselves, where {FILLED} and more is expected; check the convention of the "
        f"poses, which is to be {CONVENTION}, and scale, centre and camera"
    ]


def _fill_masks(data, model, lens):
    """Share of an object's masks that the block carved by them fills."""
    rotations = to_rotation(data.rows("quaternions", model)).as_matrix()
    masks = data.rows("masks", model) > 127
    # So coarse that no gaps show between the points of the block.
    size, side = masks.shape[-1], HULL_CELLS // 2
    points = _carve_block(rotations, masks, lens)
    rows, columns, inside = _find_cells(points, rotations, side, lens)
    view = np.broadcast_to(np.arange(len(masks))[:, None], inside.shape)
    ours, theirs = np.zeros((2, len(masks), side, side), bool)
    ours[view[inside], rows[inside], columns[inside]] = True
    view, rows, columns = np.nonzero(masks)
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
