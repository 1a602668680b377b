"""A user's own images: a folder per object, each with any number of masked views.

The mask of an image is its alpha channel, or the file `NAME_mask.png` beside it. A
folder that holds images itself, and no folders of them, has one object per image.
"""

import contextlib
import os
from pathlib import Path

import numpy as np

from dpc_jax import files
from dpc_jax.data import splits
from dpc_jax.data.sets import framing, masks, pose_files
from dpc_jax.data.sets.pictures import SUFFIXES, read_picture, to_colors
from dpc_jax.data.sources import Model, Source
from dpc_jax.data.spec import DataSpec

FEWEST_OBJECTS = 3  # that can be split


class ImageFolder(Source):
    """A user's own images, cut out and scaled as if taken by the data set's camera."""

    def find_models(self) -> dict[str, Path]:
        """See `Source.find_models`; poses are given for all objects or none."""
        models = _list_objects(self.folder)
        posed = [path for path in models.values() if pose_files.find_pose_files(path)]
        if posed and len(posed) < len(models):
            lacking = next(path for path in models.values() if path not in posed)
            raise ValueError(
                f"Expected poses for all objects of {self.folder} or for none, but "
                f"{posed[0]} has a pose file and {lacking} does not; add or remove one."
            )
        return models

    def split_models(self, models: dict[str, Path]) -> dict[str, list[str]]:
        """See `Source.split_models`; all splits hold one or two objects."""
        if len(models) < FEWEST_OBJECTS:
            remark = "has too few objects to split: all splits hold them all"
            self.remarks.append((str(self.folder), remark))
            return dict.fromkeys(splits.SPLITS, list(models))
        return super().split_models(models)

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        """See `Source.identify_model`; it changes with any file of the object."""
        images = list_images(path)
        beside = filter(None, map(masks.find_mask_file, images))
        found = {*images, *path.rglob("*"), *beside}
        facts = [
            [os.path.relpath(file, path.parent), status.st_size, status.st_mtime_ns]
            for file in sorted(found)
            if file.is_file() and (status := file.stat())
        ]
        return len(images), files.digest_text(str(facts))

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        return read_views(Path(str(model.path)), self.spec)[1:]


def _list_objects(folder):
    """Folders of views, or images, by name."""
    if pose_files.find_pose_files(folder):
        return {folder.resolve().name: folder}
    folders = (place for place in sorted(folder.iterdir()) if place.is_dir())
    places = [p for p in folders if list_images(p) or pose_files.find_pose_files(p)]
    places = places or find_images(folder)
    if not places:
        raise ValueError(
            f"Expected folders of images ({', '.join(SUFFIXES)}) in {folder}, but "
            "found none; give the folder that holds one folder per object."
        )
    return {place.stem if place.is_file() else place.name: place for place in places}


def list_images(place: Path) -> list[Path]:
    """The images of an object, sorted; those that its poses name if they have lenses.

    A damaged file of poses is reported when the object is read, and left out.
    """
    if place.is_file():
        return [place]
    found = pose_files.find_pose_files(place)
    listed = [p for p in found if p.name != pose_files.QUATERNIONS]
    with contextlib.suppress(ValueError):
        if listed:
            return sorted(pose_files.read_poses(listed))
    return find_images(place)


def find_images(folder: Path) -> list[Path]:
    """The image files in a folder but masks, sorted."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    return sorted(p for p in found if p.is_file() and not p.stem.endswith("_mask"))


def read_views(
    place: Path, spec: DataSpec
) -> tuple[list[Path], dict[str, np.ndarray], list[str]]:
    """The files whose views are used, the views, and a sentence on each other file.

    A view without a usable mask, or without a pose where others have one, is left out.
    """
    images, notes, outlines, poses = list_images(place), [], {}, None
    if found := pose_files.find_pose_files(place):
        poses = pose_files.read_poses(found)
    for path in images:
        try:
            if poses is not None and path not in poses:
                raise ValueError(
                    f"Expected a pose of {path}, but there is none; add it."
                )
            _, mask = _read_image(path)
            outlines[path] = framing.trace_outline(mask > 0.5)
        except ValueError as error:
            notes.append(str(error).removesuffix("."))
    if not outlines and len(notes) == 1:
        raise ValueError(f"{notes[0]}.")
    if not images and any(path.is_dir() for path in place.iterdir()):
        raise ValueError(
            f"Expected the images of one object in {place}, but it holds folders; give "
            "one of them."
        )
    if not outlines:
        raise ValueError(
            f"Expected at least one usable view in {place}, but none of {len(images)} "
            f"is; {notes[0] if notes else 'add images'}."
        )
    given = None if poses is None else [poses[path] for path in outlines]
    try:
        frames = framing.frame_views(list(outlines.values()), given, spec)
    except ValueError as error:
        raise ValueError(f"In the poses of {place}: {error}") from None
    arrays = framing.cut_frames(map(_read_image, outlines), frames, spec)
    return list(outlines), arrays, notes


def _read_image(path):
    """Colours uint8 and mask float32 (0 to 1) of an image file, upright."""
    image = read_picture(path)
    mask = masks.read_mask(image, path)
    masks.check_mask(mask, str(masks.find_mask_file(path) or path))
    return to_colors(image), mask
