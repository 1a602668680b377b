"""Checks of a rendered data set, before training."""

import numpy as np

from dpc_jax.data.dataset import DataSet
from dpc_jax.data.look import pose_checks
from dpc_jax.data.look.findings import Finding, name_places
from dpc_jax.data.look.pose_conventions import Lens

SMALL = 0.005  # share of the image that the smallest useful mask covers
FULL = 0.98  # and the largest
LENGTH_FLAW = 1e-3  # of a unit quaternion
WHITE = 250  # darkest mean background that passes for white


def check_set(data: DataSet, lens: Lens) -> list[Finding]:
    """What is wrong with a data set; an empty list if nothing is."""
    finder = _Finder(data, lens)
    for model in range(len(data.names)):
        finder.look_at(model)
    return [
        *finder.report(),
        *pose_checks.check_poses(data, lens),
        *_list_skipped(data),
    ]


def _list_skipped(data):
    """A finding on the objects that were left out of the set."""
    if not data.skipped:
        return []
    count, total = len(data.skipped), len(data.names) + len(data.skipped)
    names = name_places([name for name, _ in data.skipped])
    text = f"{count} of {total} objects left out as unusable: {names}; show tells why"
    return [Finding("warning", text)]


class _Finder:
    """Goes through the models once and gathers what is wrong by kind."""

    def __init__(self, data, lens):
        self._data, self._lens = data, lens
        self._views = 0
        self._found = {}

    def _note(self, level, kind, model, views=None):
        name = self._data.names[model]
        places = [name]
        if views is not None:
            places = [f"{name} view {view}" for view in np.flatnonzero(views)]
        self._found.setdefault((level, kind), []).extend(places)

    def look_at(self, model):
        data = self._data
        masks = np.asarray(data.masks[model])[: data.counts[model]]
        self._views += len(masks)
        if len(masks) < 2:
            self._note("warning", "have fewer than two views", model)
        share = masks.mean(axis=(1, 2)) / 255.0
        covered = masks > 127
        self._note("error", "an empty mask", model, share == 0)
        small = (share > 0) & (share < SMALL)
        self._note("warning", f"a mask below {SMALL:.1%} of the image", model, small)
        self._note("error", "a mask that fills the image", model, share > FULL)
        rim = np.concatenate(
            [covered[:, [0, -1]].any(axis=1), covered[:, :, [0, -1]].any(axis=2)],
            axis=1,
        ).any(axis=1)
        cut = rim & (share <= FULL)
        self._note("error", "an object cut by the frame", model, cut)
        self._look_at_images(model, masks)
        if data.depths is not None:
            self._look_at_depths(model, covered)
        if data.quaternions is not None:
            rows = np.asarray(data.quaternions[model])[: len(masks)].astype(np.float64)
            broken = ~np.all(np.isfinite(rows), axis=1)
            self._note("error", "a quaternion with NaN or infinity", model, broken)
            length = np.linalg.norm(np.where(broken[:, None], 0.5, rows), axis=1)
            bent = np.abs(length - 1.0) > LENGTH_FLAW
            self._note("error", "a quaternion that is not of length 1", model, bent)
        if data.surfaces is not None:
            points = np.asarray(data.surfaces[model])
            if not np.isfinite(points).all() or len(points) == 0:
                self._note("error", "have surface points with NaN or none", model)
            elif not 0.5 < np.linalg.norm(np.ptp(points, axis=0)) < 1.1:
                self._note(
                    "warning", "have surface points whose box diagonal is not 1", model
                )

    def _look_at_images(self, model, masks):
        images = np.asarray(self._data.images[model])[: len(masks)]
        outside = masks == 0
        count = np.maximum(outside.sum(axis=(1, 2)), 1)
        mean = (images.mean(axis=-1) * outside).sum(axis=(1, 2)) / count
        dark = (mean < WHITE) & (outside.any(axis=(1, 2)))
        self._note("warning", "a background that is not white", model, dark)
        inside = masks == 255
        blank = (images.min(axis=-1) == 255) | ~inside
        white = blank.all(axis=(1, 2)) & inside.any(axis=(1, 2))
        self._note("warning", "an object as white as its background", model, white)

    def _look_at_depths(self, model, covered):
        depths = np.asarray(self._data.depths[model])[: len(covered)]
        broken = ~np.isfinite(depths).all(axis=(1, 2))
        self._note("error", "a depth with NaN or infinity", model, broken)
        depths = np.where(np.isfinite(depths), depths, self._lens.distance)
        missing = (covered & (depths <= 0)).any(axis=(1, 2))
        self._note("error", "no depth where the mask is covered", model, missing)
        # a shape of box diagonal 1 reaches half of it to both sides
        off = covered & (np.abs(depths - self._lens.distance) > 0.55) & (depths > 0)
        self._note("error", "depth beyond where the object is", model, off.any((1, 2)))

    def report(self):
        """The findings, errors first, with the first offenders by name."""
        findings = []
        for (level, kind), places in sorted(self._found.items()):
            if not places:
                continue
            what = f"{self._views} views with {kind}"
            if kind.startswith("have "):
                what = f"{len(self._data.names)} objects {kind}"
            text = f"{len(places)} of {what}: {name_places(places)}"
            findings.append(Finding(level, text))
        return findings
