"""Checks of a rendered data set, before training."""

import numpy as np

from dpc_jax.data.dataset import DataSet
from dpc_jax.data.look import pose_checks
from dpc_jax.data.look.pose_checks import Finding, name_places
from dpc_jax.data.look.pose_conventions import Lens

SMALL = 0.005  # share of the image that the smallest useful mask covers
FULL = 0.98  # and the largest
LENGTH_FLAW = 1e-3  # of a unit quaternion
WHITE = 250  # darkest mean background that passes for white


def check_set(data: DataSet, lens: Lens) -> list[Finding]:
    """What is wrong with a data set; an empty list if nothing is."""
    found, findings = {}, []
    for model, name in enumerate(data.names):
        for level, kind, views in _check_model(data, lens, model):
            places = [name]
            if views is not None:
                places = [f"{name} view {view}" for view in np.flatnonzero(views)]
            found.setdefault((level, kind), []).extend(places)
    for (level, kind), places in sorted(found.items()):
        what = f"{int(np.sum(data.counts))} views with {kind}"
        if kind.startswith("have "):
            what = f"{len(data.names)} objects {kind}"
        if places:
            text = f"{len(places)} of {what}: {name_places(places)}"
            findings.append(Finding(level, text))
    findings += pose_checks.check_poses(data, lens)
    if data.skipped:
        count, total = len(data.skipped), len(data.names) + len(data.skipped)
        names = name_places([name for name, _ in data.skipped])
        text = f"{count} of {total} objects left out as unusable: {names}"
        findings.append(Finding("warning", f"{text}; show tells why"))
    return findings


def _check_model(data, lens, model):
    """(level, fault, which views have it or None for the object as a whole)."""
    masks = data.rows("masks", model)
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
    yield from _check_images(data.rows("images", model), masks)
    if data.depths is not None:
        yield from _check_depths(data.rows("depths", model), covered, lens)
    if data.quaternions is not None:
        rows = data.rows("quaternions", model).astype(np.float64)
        broken = ~np.all(np.isfinite(rows), axis=1)
        yield "error", "a quaternion with NaN or infinity", broken
        length = np.linalg.norm(np.where(broken[:, None], 0.5, rows), axis=1)
        bent = np.abs(length - 1.0) > LENGTH_FLAW
        yield "error", "a quaternion that is not of length 1", bent
    if data.surfaces is not None:
        points = np.asarray(data.surfaces[model])
        if not np.isfinite(points).all() or len(points) == 0:
            yield "error", "have surface points with NaN or none", None
        elif not 0.5 < np.linalg.norm(np.ptp(points, axis=0)) < 1.1:
            yield "warning", "have surface points whose box diagonal is not 1", None


def _check_images(images, masks):
    outside, inside = masks == 0, masks == 255
    count = np.maximum(outside.sum(axis=(1, 2)), 1)
    mean = (images.mean(axis=-1) * outside).sum(axis=(1, 2)) / count
    dark = (mean < WHITE) & (outside.any(axis=(1, 2)))
    yield "warning", "a background that is not white", dark
    blank = (images.min(axis=-1) == 255) | ~inside
    white = blank.all(axis=(1, 2)) & inside.any(axis=(1, 2))
    yield "warning", "an object as white as its background", white


def _check_depths(depths, covered, lens):
    broken = ~np.isfinite(depths).all(axis=(1, 2))
    yield "error", "a depth with NaN or infinity", broken
    depths = np.where(np.isfinite(depths), depths, lens.distance)
    missing = (covered & (depths <= 0)).any(axis=(1, 2))
    yield "error", "no depth where the mask is covered", missing
    # a shape of box diagonal 1 reaches half of it to both sides
    off = covered & (np.abs(depths - lens.distance) > 0.55) & (depths > 0)
    yield "error", "depth beyond where the object is", off.any((1, 2))
