"""Checks of poses and depths: do they put the object where its mask is?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dpc_jax.data.dataset import DataSet
from dpc_jax.data.look import pose_conventions
from dpc_jax.data.look.pose_conventions import Lens

TRIED_VIEWS = 64  # number of views that conventions are tried on
TRIED_POINTS = 10_000  # of a surface that are used
FIT = 0.85  # intersection over union of right poses: 0.92 and above on real meshes
STRAY = 0.9  # share of a surface inside its own mask: above 0.99 for right poses
FILLED = 0.95  # share of masks that hulls fill: 0.98 and above for right poses
RAY = 0.4  # between 0, depth along the axis, and 1, along the ray
CLEARER = 0.02  # by which another convention must fit better
DEPTH_FLAW = 0.05  # of the object's box diagonal
NAMED = 5  # offenders that a finding names


class Finding(NamedTuple):
    """One fault of a set. level: "error", or "warning" if it may be intended."""

    level: str
    text: str


def name_places(places: Sequence[str]) -> str:
    """The first of some places as text, and how many more there are."""
    more = len(places) - NAMED
    return ", ".join(places[:NAMED]) + (f" and {more} more" if more > 0 else "")


def check_poses(data: DataSet, lens: Lens) -> list[Finding]:
    """Check whether poses put objects where their masks are.

    Surface points under the stored poses are compared with the masks; without surfaces,
    the masks of an object's views are compared with each other. If another convention
    fits better, it is named, and so are single poses that stray from their masks.
    """
    chosen = [] if data.quaternions is None else _choose_models(data)
    if not chosen:
        return []
    others = pose_conventions.OTHERS
    if data.surfaces is None:  # then the object's axes cannot be told apart
        others = [c for c in others if np.array_equal(c.object, np.eye(3))]
    stored, *scores = (
        np.mean([_score(data, m, convention, lens) for m in chosen])
        for convention in (pose_conventions.STORED, *others)
    )
    best = max(scores)
    measure, enough = "overlap with the masks", FIT
    if data.surfaces is None:
        measure, enough = "share of the masks that agrees", FILLED
    if best > stored + CLEARER:
        near = np.flatnonzero(np.greater(scores, best - CLEARER / 4))
        same = [others[place].name for place in near]
        text = f"the poses follow another convention: {' or '.join(same)}"
        if best < enough:
            text = "the poses follow no convention known here; the nearest is "
            text += same[0]
        text += (
            f" ({measure} {best:.2f}); as stored, which should be "
            f"{pose_conventions.STORED.name}, it is {stored:.2f}; convert the poses."
        )
        return [Finding("error", text)]
    strays = [] if data.surfaces is None else _find_strays(data, lens)
    if stored < enough and not 0 < len(strays) < np.sum(data.counts) / 2:
        text = (
            f"the poses do not fit the masks ({measure} {stored:.2f}, expected "
            f"{enough} and more) under any convention known here; check scale, centre "
            "and camera."
        )
        return [Finding("error", text)]
    findings = []
    if strays:
        text = (
            f"{len(strays)} of {int(np.sum(data.counts))} views whose pose puts the "
            f"object beside its mask: {name_places(strays)}"
        )
        findings.append(Finding("error", text))
    if data.surfaces is not None and data.depths is not None:
        findings += _check_depths(data, chosen, lens)
    return findings


def _choose_models(data):
    """Models to try conventions on, spread over the set."""
    finite = [
        m
        for m in range(len(data.names))
        if data.counts[m] >= (1 if data.surfaces is not None else 3)
        and np.isfinite(np.asarray(data.quaternions[m])).all()
        and np.asarray(data.masks[m]).any()
        and (data.surfaces is None or _read_surface(data, m) is not None)
    ]
    if not finite:
        return []
    count = max(1, TRIED_VIEWS // int(max(1, np.max(data.counts))))
    places = np.linspace(0, len(finite) - 1, min(count, len(finite))).round()
    return [finite[int(place)] for place in places]


def _read_surface(data, model):
    """Some of a model's surface points, or None if they cannot be used."""
    points = np.asarray(data.surfaces[model])
    if len(points) == 0 or not np.isfinite(points).all():
        return None
    return points[:: max(1, len(points) // TRIED_POINTS)]


def _score(data, model, convention, lens):
    surface = None if data.surfaces is None else _read_surface(data, model)
    quaternions, masks = data.rows("quaternions", model), data.rows("masks", model)
    return pose_conventions.score_convention(
        convention, quaternions, masks, surface, lens
    )


def _find_strays(data, lens):
    strays = []
    for model, name in enumerate(data.names):
        surface = _read_surface(data, model)
        if surface is None:
            continue
        surface = surface[:: max(1, len(surface) // 1000)]
        masks = pose_conventions.grow_masks(data.rows("masks", model) > 0, 1)
        quaternions = data.rows("quaternions", model)
        rotations = pose_conventions.rotation_of(quaternions)
        places, _ = pose_conventions.project_points(surface, rotations, lens)
        (rows, columns), within = pose_conventions.find_cells(places, masks.shape[-1])
        hits = masks[np.arange(len(masks))[:, None], rows, columns] & within
        usable = masks.any(axis=(1, 2)) & np.all(np.isfinite(quaternions), axis=1)
        strays += [
            f"{name} view {view} ({share:.0%} inside)"
            for view, share in enumerate(hits.mean(axis=1))
            if share < STRAY and usable[view]
        ]
    return strays


def _check_depths(data, chosen, lens):
    given, expected, longer = (
        np.concatenate(parts)
        for parts in zip(*(_pair_depths(data, m, lens) for m in chosen), strict=True)
    )
    if len(given) == 0:
        return []
    off = float(np.median(given - expected))
    if abs(off) > DEPTH_FLAW:
        reason = f"it is off by {off:.3f} in the median pixel"
        if abs(off + lens.distance) < DEPTH_FLAW:
            reason = f"it is counted from the object's middle, {lens.distance:g} less"
    else:
        # the length of a ray exceeds its depth, the more the farther from the axis; a
        # slope, because the nearest of a pixel's points is nearer than their mean
        near = np.abs(given - expected) < DEPTH_FLAW
        extra, longer = (given - expected)[near], longer[near]
        longer = longer - longer.mean() if len(longer) else longer
        if not longer @ extra > RAY * (longer @ longer):
            return []
        reason = "it is the length of the ray"
    text = "the depth is not the metric distance along the camera's axis"
    return [Finding("error", f"{text}: {reason}; convert the depth.")]


def _pair_depths(data, model, lens):
    """Stored depths, depths of the nearest points, and by how much rays are longer."""
    rotations = pose_conventions.rotation_of(data.rows("quaternions", model))
    surface = _read_surface(data, model)
    assert surface is not None  # models without are not chosen
    places, z = pose_conventions.project_points(surface, rotations, lens)
    masks = data.rows("masks", model)
    depths = data.rows("depths", model).astype(np.float64)
    size = masks.shape[-1]
    (rows, columns), _ = pose_conventions.find_cells(places, size)
    nearest = np.full(masks.shape, np.inf)
    np.minimum.at(nearest, (np.arange(len(masks))[:, None], rows, columns), z)
    use = np.isfinite(nearest) & (masks == 255) & np.isfinite(depths)
    axis = ((np.arange(size) + 0.5) / size - 0.5) * lens.extent / lens.focal_length
    stretch = np.sqrt(1.0 + axis**2 + axis[:, None] ** 2) - 1.0
    stretch, expected = np.broadcast_to(stretch, masks.shape), nearest[use]
    return depths[use], expected, expected * stretch[use]
