"""The renders published with the paper's code, read as they are.

`SYNSET/MODEL/render_N.png` has colour and alpha, `depth_N.png` 16 bits that stand for
0 to 10 units, and `camera_N.mat` the camera: `extrinsic`, the 4 x 4 matrix from the
world to a camera with x right, y down and z forward, `pos`, its place in the world, and
`K`, the lens in pixels. The world has z up and the model's +x stays +x, so for ShapeNet
version 1, whose models face +x, it is the canonical frame.

Ground truth published beside them, `MODEL.mat` with `points`, is in the axes of the
ShapeNet files: y up.
"""

import hashlib
import os
import re
from pathlib import Path

import numpy as np
from PIL import Image

from dpc_jax.data import viewpoints
from dpc_jax.data.sets import shapenet

FARTHEST = 10.0  # depth that the largest value of a depth file stands for
GROUND_TRUTH = "gt/downsampled"  # where the released scripts put it, beside the renders
TOLERANCE = 1e-3  # of the camera, in its own units
FAULTS = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)  # of Pillow


def list_models(place):
    """Folders of models by id, sorted: `{id: path}`.

    Raises:
      ValueError: naming the folder, if no model in it has a render.
    """
    names = sorted(entry.name for entry in os.scandir(place) if entry.is_dir())
    if not any(list_renders(place / name) for name in names):
        raise ValueError(
            f"expected MODEL/render_0.png and further views in {place}, found none; "
            "give the folder that the published renders are unpacked in."
        )
    return {name: place / name for name in names}


def list_renders(place):
    """Numbers of the renders of a model, ascending; none if there is no folder."""
    if not place.is_dir():
        return []
    found = (re.fullmatch(r"render_(\d+)\.png", name) for name in os.listdir(place))
    return sorted(int(match[1]) for match in found if match)


def find_ground_truth(folder, synset, given=None):
    """Folder of a synset's ground truth, as given or as the scripts leave it, or None.

    Raises:
      ValueError: if one is given that has no file.
    """
    if given:
        for place in (Path(given) / synset, Path(given)):
            if place.is_dir() and any(place.glob("*.mat")):
                return place
        raise ValueError(
            f"expected MODEL.mat in {given} or its folder {synset}, found none; give "
            "the folder of the published ground truth."
        )
    for above in (Path(folder), Path(folder).parent):
        place = above / GROUND_TRUTH / synset
        if place.is_dir():
            return place
    return None


def describe_model(place, truth, *, views):
    """A key of a model's files from their sizes."""
    files = [
        place / f"{kind}_{n}.{ending}"
        for n in list_renders(place)[:views]
        for kind, ending in (("render", "png"), ("depth", "png"), ("camera", "mat"))
    ]
    files += [truth] if truth else []
    sizes = [path.stat().st_size if path.is_file() else -1 for path in files]
    return hashlib.sha256(f"{place.name} {sizes}".encode()).hexdigest()


def read_model(place, truth, *, views, image_size, focal_length, distance):
    """The first views of one model, at the size and with the camera of the data set.

    Args:
      place: the model's folder. truth: its ground truth file, or None.
      views: how many. image_size, focal_length, distance: of the data set.

    Returns:
      arrays by name: images, masks, depths, quaternions and, with truth, surfaces.

    Raises:
      ValueError: naming the file, if there are too few views, one of its files is
        missing or damaged, or the camera is not the data set's.
    """
    numbers = list_renders(place)[:views]
    if len(numbers) < views:
        raise ValueError(
            f"expected {views} views render_N.png in {place}, found {len(numbers)}; "
            "set data.views lower or unpack the renders again."
        )
    arrays = {"images": [], "masks": [], "depths": [], "quaternions": []}
    for number in numbers:
        image, mask, depth = _read_pictures(place, number, image_size)
        rotation = read_camera(
            place / f"camera_{number}.mat",
            width=_open(place / f"render_{number}.png").size[0],
            focal_length=focal_length,
            distance=distance,
        )
        arrays["images"].append(image)
        arrays["masks"].append(mask)
        arrays["depths"].append(depth)
        quaternion = viewpoints.matrix_to_quaternion(rotation)
        arrays["quaternions"].append(quaternion.astype(np.float32))
    arrays = {name: np.stack(rows) for name, rows in arrays.items()}
    if truth is not None:
        arrays["surfaces"] = read_ground_truth(truth)
    return arrays


def _read_pictures(place, number, image_size):
    """(image, mask, depth) of a view; area means, so that nothing is shifted."""
    path = place / f"render_{number}.png"
    picture = _open(path)
    if picture.mode != "RGBA" or picture.size[0] != picture.size[1]:
        raise ValueError(
            f"expected a square image with alpha in {path}, got {picture.mode} of "
            f"{picture.size}; unpack the renders again."
        )
    pixels = np.asarray(picture).astype(np.float32)
    covered = pixels[..., 3] / 255.0
    on_white = pixels[..., :3] * covered[..., None] + 255.0 * (1.0 - covered[..., None])
    path = place / f"depth_{number}.png"
    raw = np.asarray(_open(path))
    if raw.shape != covered.shape or raw.dtype.kind not in "iu" or raw.itemsize < 2:
        raise ValueError(
            f"expected 16-bit depth of {covered.shape} in {path}, got {raw.dtype} "
            f"{raw.shape}; unpack the renders again."
        )
    metric = raw.astype(np.float32) * (FARTHEST / 65535.0)
    valid = (covered > 0) & (raw < 65535)
    weight = shrink(np.where(valid, covered, 0.0), image_size)
    total = shrink(np.where(valid, covered * metric, 0.0), image_size)
    depth = np.divide(total, weight, out=np.zeros_like(total), where=weight > 1e-3)
    image = np.stack([shrink(on_white[..., c], image_size) for c in range(3)], axis=-1)
    mask = 255.0 * shrink(covered, image_size)
    return np.rint(image).astype(np.uint8), np.rint(mask).astype(np.uint8), depth


def shrink(image, size):
    """Area mean of a square float image, also where pixels are split between two."""
    source = Image.fromarray(np.ascontiguousarray(image, dtype=np.float32))
    return np.asarray(source.resize((size, size), Image.Resampling.BOX))


def read_camera(path, *, width, focal_length, distance):
    """Rotation [3, 3] from the canonical frame to the camera of a view.

    Raises:
      ValueError: naming the file, if it cannot be read or contradicts itself, or the
        camera has another focal length or distance than the data set's.
    """
    content = _read_mat(path, ("extrinsic", "pos", "K"))
    extrinsic, position, lens = (content[n] for n in ("extrinsic", "pos", "K"))
    position = position.ravel()
    if extrinsic.shape != (4, 4) or position.shape != (3,) or lens.shape != (3, 3):
        raise ValueError(
            f"expected extrinsic [4, 4], pos [3] and K [3, 3] in {path}, got "
            f"{extrinsic.shape}, {position.shape} and {lens.shape}; unpack the archive "
            "again."
        )
    rotation, shift = extrinsic[:3, :3], extrinsic[:3, 3]
    flaws = [
        np.abs(rotation @ rotation.T - np.eye(3)).max(),
        abs(np.linalg.det(rotation) - 1.0),
        np.abs(rotation @ position + shift).max(),
        np.abs(shift[:2]).max(),  # it looks at the origin
    ]
    if not max(flaws) < TOLERANCE or shift[2] <= 0:
        raise ValueError(
            f"expected a camera in {path} that looks at the origin from pos, got one "
            f"that does not (by {max(flaws):.2g}); unpack the renders again."
        )
    found = lens[0, 0] / width, shift[2]
    if max(abs(found[0] - focal_length), abs(found[1] - distance)) > 1e-2:
        raise ValueError(
            f"expected focal length {focal_length} and distance {distance} in {path}, "
            f"got {found[0]:.4g} and {found[1]:.4g}; set render.focal_length and "
            "render.distance."
        )
    return rotation


def read_ground_truth(path):
    """Points [P, 3] float32 in the canonical frame.

    Raises:
      ValueError: naming the file, if it cannot be read or holds no finite points.
    """
    points = _read_mat(path, ("points",))["points"]
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"expected finite points [P, 3] in {path}, got {points.shape}; download "
            "the ground truth again."
        )
    return (points @ np.array(shapenet.TURNS["+x"]).T).astype(np.float32)


def _read_mat(path, names):
    """Arrays of numbers, float64, by name."""
    from scipy.io import loadmat

    if not path.is_file():
        raise ValueError(f"expected {path}, found none; unpack the archive again.")
    try:
        content = loadmat(path)
    except Exception as error:  # the reader raises anything at all on damaged files
        raise ValueError(
            f"expected a MATLAB file in {path}, got {type(error).__name__}: {error}; "
            "unpack the archive again."
        ) from None
    missing = [name for name in names if name not in content]
    if missing:
        raise ValueError(
            f"expected {', '.join(names)} in {path}, {', '.join(missing)} is missing; "
            "unpack the archive again."
        )
    try:
        return {name: np.asarray(content[name], dtype=np.float64) for name in names}
    except (ValueError, TypeError) as error:  # texts, cells, structures
        raise ValueError(
            f"expected numbers in {', '.join(names)} of {path}, got others ({error}); "
            "unpack the archive again."
        ) from None


def _open(path):
    try:
        with Image.open(path) as image:
            image.load()
            return image
    except FAULTS as error:
        raise ValueError(
            f"expected a readable image in {path}, got {type(error).__name__}: {error}"
        ) from None
