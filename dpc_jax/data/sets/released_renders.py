"""The renders published with the paper's code, read as they are.

`SYNSET/MODEL/render_N.png` has colour and alpha, `depth_N.png` 16 bits that stand for
0 to 10 units, and `camera_N.mat` the camera: `extrinsic`, the 4 x 4 matrix from the
world to a camera with x right, y down and z forward, and `K`, the lens in pixels. The
world has z up and the model's +x stays +x, so for ShapeNet version 1, whose models face
+x, it is the canonical frame.

The ground truth published beside them, `MODEL.mat` with `points`, is in the axes of the
ShapeNet files: y up.
"""

import functools
import os
import re
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax import files
from dpc_jax.data import viewpoints
from dpc_jax.data.sets import pictures, shapenet
from dpc_jax.data.sources import Model

FARTHEST = 10.0  # depth that the largest value of a depth file stands for
GROUND_TRUTH = "gt/downsampled"  # where the released scripts put it, beside the renders


class ReleasedRenders(shapenet.SynsetSource):
    """Published renders with their cameras and, for val and test, ground truth."""

    def find_models(self) -> dict[str, Path]:
        return _list_models(self.place)

    @functools.cached_property
    def truths(self) -> Path | None:
        """Folder of the ground truth, where the published scripts leave it."""
        above = (self.folder, self.folder.parent)
        places = (folder / GROUND_TRUTH / self.synset for folder in above)
        return next((place for place in places if place.is_dir()), None)

    def find_truth(self, name: str) -> Path | None:
        """Ground truth file of a model; models to train on need none."""
        if self.truths is None or self.spec.split == "train":
            return None
        return self.truths / f"{name}.mat"

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        listed = [
            path / f"{kind}_{number}.{ending}"
            for number in _list_renders(path)[: self.spec.views]
            for kind, ending in (("render", "png"), ("depth", "png"), ("camera", "mat"))
        ]
        truth = self.find_truth(name)
        sizes = files.list_sizes([*listed, truth] if truth else listed)
        return self.spec.views, files.digest_text(f"{path.name} {sizes}")

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        spec, place = self.spec, Path(str(model.path))
        numbers = _list_renders(place)[: spec.views]
        if len(numbers) < spec.views:
            raise ValueError(
                f"Expected {spec.views} views render_N.png in {place}, but found "
                f"{len(numbers)}; set data.views lower or unpack the renders again."
            )
        views = []
        for number in numbers:
            *view, width = _read_pictures(place, number, spec.image_size)
            rotation = _read_camera(place / f"camera_{number}.mat", spec, width=width)
            views.append((*view, rotation))
        arrays = viewpoints.stack_views(views)
        truth = self.find_truth(model.name)
        if truth is not None:
            arrays["surfaces"] = _read_ground_truth(truth)
        return arrays, []


def _list_models(place):
    names = sorted(entry.name for entry in os.scandir(place) if entry.is_dir())
    if not any(_list_renders(place / name) for name in names):
        raise ValueError(
            f"Expected MODEL/render_0.png and further views in {place}, but there are "
            "none; give the folder that the published renders are unpacked in."
        )
    return {name: place / name for name in names}


def count_views(place: Path) -> int:
    """The number of views that most models of a synset's folder have."""
    models = _list_models(place).values()
    counts = Counter(len(_list_renders(model)) for model in models)
    return max(1, counts.most_common(1)[0][0])


def _list_renders(place):
    """Numbers of the renders of a model, ascending."""
    found = (re.fullmatch(r"render_(\d+)\.png", name) for name in os.listdir(place))
    return sorted(int(match[1]) for match in found if match)


def _read_pictures(place, number, image_size):
    """(image, mask, depth, width of the file) of a view.

    Pictures shrink by area means, so that nothing is shifted.
    """
    path = place / f"render_{number}.png"
    picture = pictures.read_picture(path)
    if picture.mode != "RGBA" or picture.width != picture.height:
        found = f"it is {picture.mode} of {picture.size}"
        raise _refuse(path, "a square image with alpha", found)
    pixels = np.asarray(picture).astype(np.float32)
    covered = pixels[..., 3] / 255.0
    on_white = pixels[..., :3] * covered[..., None] + 255.0 * (1.0 - covered[..., None])
    path = place / f"depth_{number}.png"
    raw = np.asarray(pictures.read_picture(path))
    if raw.shape != covered.shape or raw.dtype.kind not in "iu" or raw.itemsize < 2:
        found = f"it is {raw.dtype} {raw.shape}"
        raise _refuse(path, f"16-bit depth of {covered.shape}", found)
    metric = raw.astype(np.float32) * (FARTHEST / 65535.0)
    valid = (covered > 0) & (raw < 65535)
    weight = _shrink(np.where(valid, covered, 0.0), image_size)
    total = _shrink(np.where(valid, covered * metric, 0.0), image_size)
    depth = np.divide(total, weight, out=np.zeros_like(total), where=weight > 1e-3)
    image = np.stack([_shrink(on_white[..., c], image_size) for c in range(3)], axis=-1)
    mask = 255.0 * _shrink(covered, image_size)
    return np.rint(image), np.rint(mask), depth, picture.width


def _shrink(image, size):
    """Area mean of a square float image, also where new pixels cut old ones."""
    source = Image.fromarray(np.ascontiguousarray(image, dtype=np.float32))
    return np.asarray(source.resize((size, size), Image.Resampling.BOX))


def _read_camera(path, spec, *, width):
    """Rotation [3, 3] from the canonical frame to the camera of a view."""
    content = _read_mat(path, ("extrinsic", "K"))
    extrinsic, lens = content["extrinsic"], content["K"]
    if extrinsic.shape != (4, 4) or lens.shape != (3, 3):
        found = f"got {extrinsic.shape} and {lens.shape}"
        raise _refuse(path, "extrinsic [4, 4] and K [3, 3]", found)
    found = lens[0, 0] / width, extrinsic[2, 3]
    away = np.abs(np.subtract(found, (spec.focal_length, spec.distance)))
    if not away.max() <= 1e-2:
        raise ValueError(
            f"Expected focal length {spec.focal_length} and distance {spec.distance} "
            f"in {path}, but got {found[0]:.4g} and {found[1]:.4g}; set "
            "render.focal_length and render.distance."
        )
    return extrinsic[:3, :3]


def _read_ground_truth(path):
    points = _read_mat(path, ("points",))["points"]
    is_list = points.ndim == 2 and points.shape[1] == 3 and len(points) > 0
    if not is_list or not np.isfinite(points).all():
        raise _refuse(path, "finite points [P, 3]", f"got {points.shape}")
    return (points @ shapenet.TURNS[1].T).astype(np.float32)


def _read_mat(path, names):
    """Arrays of numbers, float64, by name."""
    from scipy.io import loadmat  # only these renders need it

    if not path.is_file():
        raise ValueError(
            f"Expected the file {path}, but it is missing; unpack the renders again."
        )
    with files.reading(f"numbers {', '.join(names)}", path, "unpack the renders again"):
        content = loadmat(path)
        return {name: np.asarray(content[name], dtype=np.float64) for name in names}


def _refuse(path, expected, found):
    return ValueError(
        f"Expected {expected} in {path}, but {found}; unpack the renders again."
    )
