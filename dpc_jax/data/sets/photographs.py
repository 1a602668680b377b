"""Photographs that a trained network is asked about: files, folders, videos.

Each becomes an object of one or more views, cut out and framed as in training, or as
the camera of training would have seen them, where a folder says how they were taken.
What cannot be used is named. This module loads no JAX: a bad file is told at once.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from dpc_jax.data.sets import framing, masks, pose_files
from dpc_jax.data.sets.image_folder import list_images
from dpc_jax.data.sets.pictures import MOST_SIDE, SUFFIXES, read_frames, to_colors
from dpc_jax.data.spec import DataSpec
from dpc_jax.outputs import show_text

FINEST = 128  # pixels of masks that shapes are refined by; finer ones take minutes
MOST_FRAMES = 24  # of a moving picture, in equal steps: a turn in steps of 15°


class Photographs(NamedTuple):
    """One object's views.

    Attributes:
      name: of its files. sources: what each view is from, as text.
      images: uint8 [V, S, S, 3] on white. masks: uint8 [V, S, S].
      fine_masks: uint8 [V, F, F], twice as fine up to `FINEST`.
      files: that the views are from.
      cameras: [V, 3, 3] from the world to a camera that looks straight at the object,
        as `images` are; None where cameras are not known.
      turns: [V, 3, 3] from the camera that took each photograph to that one, or None.
    """

    name: str
    sources: tuple[str, ...]
    images: np.ndarray
    masks: np.ndarray
    fine_masks: np.ndarray
    files: tuple[Path, ...]
    cameras: np.ndarray | None = None
    turns: np.ndarray | None = None


def read_photographs(
    paths: Sequence[Path],
    spec: DataSpec,
    *,
    mask: str = "given",
    is_one_object: bool = False,
) -> tuple[list[Photographs], list[tuple[str, str]]]:
    """The objects that can be used, and (source, sentence) of what is left out.

    Args:
      paths: image files, moving pictures, videos, and folders of the views of one
        object, or of such folders.
      mask: "given": alpha channel or mask file; "auto": where there is neither, the
        object before a plain background.
      is_one_object: whether all of it shows the same object.

    Raises:
      ValueError: where nothing can be used, or two objects would have the same name.
    """
    objects, skipped = [], []
    for name, files, folder in _list_objects(paths, is_one_object):
        try:
            cameras = {} if spec.crop == "none" else _read_cameras(folder)
            views = [
                view
                for file in files
                for view in _read_file(file, mask == "auto", cameras, skipped)
            ]
            if views:
                objects.append(_frame(name, views, tuple(files), spec))
        except ValueError as error:  # of cameras, which concern all views
            skipped.append((show_text(folder), show_text(error).rstrip(".")))
    if not objects:
        first = skipped[0][1]
        if len(skipped) == 1:
            raise ValueError(f"{first}.")
        raise ValueError(
            "Expected at least one image that can be used, but none of "
            f"{len(skipped)} can; of the first: {first}."
        )
    return objects, skipped


class _Object(NamedTuple):
    name: str
    files: list[Path]
    folder: Path | None = None  # which may hold the cameras of the files


def _list_objects(paths, is_one_object) -> list[_Object]:
    found = [each for path in paths for each in _expand(path)]
    if is_one_object and len(found) > 1:  # of different cameras, perhaps
        return [_Object("object", [file for one in found for file in one.files])]
    names = [one.name for one in found]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(
            f"Expected images of different names, but {', '.join(repeated)} came more "
            "than once; predict them one by one with an --out of their own."
        )
    return found


def _expand(path: Path) -> list[_Object]:
    if not path.is_dir():
        return [_Object(show_text(path.stem), [path])]
    if files := list_images(path):
        return [_Object(show_text(path.resolve().name), files, path)]
    inner = [p for p in sorted(path.iterdir()) if p.is_dir()]
    found = [_Object(show_text(p.name), list_images(p), p) for p in inner]
    if found := [one for one in found if one.files]:
        return found
    raise ValueError(
        f"Expected images ({', '.join(SUFFIXES)}) in the folder {path} or in folders "
        "in it, but there are none; check the path."
    )


def _read_cameras(folder: Path | None) -> dict[Path, pose_files.Pose]:
    """Cameras of known place and lens by image; none where the folder has no such."""
    found = pose_files.find_pose_files(folder) if folder else []
    return pose_files.read_poses([p for p in found if p.name != pose_files.QUATERNIONS])


class _View(NamedTuple):
    """A photograph, of which only the part that shows the object is kept.

    part: RGBA of the object's box. to_part: [3, 3] from pixels of the photograph to
    pixels of the part.
    """

    source: str
    outline: framing.Outline
    part: Image.Image
    to_part: np.ndarray
    camera: pose_files.Pose | None


def _read_file(path, finds_masks, cameras, skipped) -> list[_View]:
    """Each frame that can be used; others are noted."""
    try:
        if not path.is_file():
            problem = "is no regular file" if path.exists() else "is not there"
            raise ValueError(f"Expected an image file, but {path} {problem}; check it.")
        if cameras and path not in cameras:
            raise ValueError(f"Expected a pose of {path}, but there is none; add it.")
        frames = read_frames(path, MOST_FRAMES)
    except (OSError, ValueError) as error:
        skipped.append((show_text(path), show_text(error).rstrip(".")))
        return []
    views = []
    for number, frame in enumerate(frames):
        source = show_text(path)
        source += f", frame {number + 1}" * (len(frames) > 1)
        try:
            mask = _find_mask(frame, path, finds_masks)
            masks.check_mask(mask, source)
        except (OSError, ValueError) as error:
            sentence = show_text(error).rstrip(".")
            if show_text(path) not in sentence:
                sentence = f"{source}: {sentence}"
            skipped.append((source, sentence))
            continue
        outline, camera = framing.trace_outline(mask > 0.5), cameras.get(path)
        views.append(_View(source, outline, *_keep_object(frame, mask), camera))
    return views


def _keep_object(frame, mask) -> tuple[Image.Image, np.ndarray]:
    """The part and the matrix of a `_View`: hundreds of photographs fit into memory."""
    whole = Image.fromarray(to_colors(frame))
    whole.putalpha(Image.fromarray(np.rint(255 * mask).astype(np.uint8)))
    box = whole.getchannel("A").getbbox()
    assert box, "a mask that passed its check shows something"
    corners = np.reshape(box, (2, 2))
    side = int(np.ptp(corners, axis=0).max())
    margin = side // 16 + 2  # of nothing, which samples at the rim mix with
    low, high = np.clip(corners + [[-margin], [margin]], 0, whole.size)
    factor = -(-side // MOST_SIDE)
    high = low + factor * -((low - high) // factor)
    part = whole.crop((*low.tolist(), *high.tolist())).reduce(factor)
    x, y = low / factor
    return part, np.array([[1 / factor, 0, -x], [0, 1 / factor, -y], [0, 0, 1]])


def _find_mask(frame, path, finds_masks) -> np.ndarray:
    if not finds_masks or frame.has_transparency_data or masks.find_mask_file(path):
        advice = ", or take --mask=auto for an object before a plain background"
        mask = masks.read_mask(frame, path, advice=advice)
        if not finds_masks or mask.min() <= 0.5:  # else its alpha is no use
            return mask
    return masks.find_before_plain_background(np.asarray(frame.convert("RGB")))


def _frame(name, views: list[_View], files, spec: DataSpec) -> Photographs:
    cameras = [view.camera for view in views if view.camera]
    outlines = [view.outline for view in views]
    frames = framing.frame_views(outlines, cameras or None, spec)
    squares = [
        frame._replace(homography=view.to_part @ frame.homography)
        for view, frame in zip(views, frames, strict=True)
    ]
    side = max(spec.image_size, min(2 * spec.image_size, FINEST))
    arrays, fine = (
        framing.cut_frames(map(_split, views), squares, wanted)
        for wanted in (spec, dataclasses.replace(spec, image_size=side))
    )
    sources = tuple(view.source for view in views)
    found = Photographs(
        *(name, sources, arrays["images"], arrays["masks"], fine["masks"], files)
    )
    if not cameras:
        return found
    turned = np.stack([f.rotation for f in frames if f.rotation is not None])
    own = np.stack([camera.rotation for camera in cameras])
    return found._replace(cameras=turned, turns=turned @ own.swapaxes(1, 2))


def _split(view: _View) -> tuple[np.ndarray, np.ndarray]:
    """Colours and mask (0 to 1) of the part of a view."""
    layers = np.asarray(view.part)
    return layers[..., :3], layers[..., 3] / np.float32(255)
