"""A user's own images: a folder per object, each with any number of masked views.

The mask of an image is its alpha channel, or the file `NAME_mask.png` beside it. A
folder that holds images itself, and no folders of them, has one object per image.
"""

import contextlib
import hashlib
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from dpc_jax.data import viewpoints
from dpc_jax.data.sets import framing, pose_files

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
FAULTS = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)  # of Pillow


def list_objects(folder):
    """Places of the objects of a folder by name, sorted: `{name: path}`.

    A place is a folder of views, or an image where each image is an object.

    Raises:
      ValueError: naming the folder, if there are no images in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"expected a folder of images, {folder} is none; check it.")
    if pose_files.find_pose_files(folder):
        return {folder.resolve().name: folder}
    places = [
        place
        for place in sorted(folder.iterdir())
        if place.is_dir() and (list_images(place) or has_poses(place))
    ]
    if not places:
        places = _find_images(folder)
    if not places:
        raise ValueError(
            f"expected folders of images ({', '.join(SUFFIXES)}) in {folder}, found "
            "none; give the folder that holds one folder per object."
        )
    return {place.stem if place.is_file() else place.name: place for place in places}


def list_images(place):
    """The images of an object, sorted; those of `transforms.json` where it has one.

    A damaged `transforms.json` is told when the object is read, which is left out then.
    """
    if place.is_file():
        return [place]
    files = [p for p in pose_files.find_pose_files(place) if p.match("transforms*")]
    with contextlib.suppress(ValueError):
        if files:
            return sorted(pose_files.read_poses(files))
    return _find_images(place)


def _find_images(folder):
    found = (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    return sorted(p for p in found if p.is_file() and not p.stem.endswith("_mask"))


def has_poses(place):
    """Whether an object comes with poses."""
    return place.is_dir() and bool(pose_files.find_pose_files(place))


def describe_object(place):
    """(number of views, key) of an object; the key changes with any of its files."""
    images = list_images(place)
    files = list(images)
    files += [mask for image in images if (mask := _find_mask(image)) is not None]
    if place.is_dir():
        files += pose_files.find_pose_files(place)
    facts = []
    for file in files:
        status = file.stat() if file.is_file() else None
        facts.append([str(file.relative_to(place.parent)) if place.is_dir() else ""])
        facts[-1] += [status and status.st_size, status and status.st_mtime_ns]
    return len(images), hashlib.sha256(str(facts).encode()).hexdigest()


def read_object(place, *, image_size, crop, fill, focal_length, distance):
    """The views of one object, cut and scaled to the data set's camera.

    A view without a usable mask, or without a pose where others have one, is left out.

    Returns:
      (arrays, notes): images uint8 [V, S, S, 3], masks uint8 [V, S, S], and, where
      there are poses, quaternions float32 [V, 4]; and what was left out, in phrases.

    Raises:
      ValueError: naming a file, if no view can be used or a pose file is damaged.
    """
    images, notes = list_images(place), []
    poses = None
    if has_poses(place):
        poses = pose_files.read_poses(pose_files.find_pose_files(place))
    outlines, kept = [], []
    for path in images:
        try:
            if poses is not None and path not in poses:
                raise ValueError(f"expected a pose of {path}, found none; add it")
            _, mask = read_image(path)
            outlines.append(framing.trace_outline(mask > 0.5))
            kept.append(path)
        except ValueError as error:
            notes.append(str(error))
    if not kept:
        raise ValueError(
            f"expected at least one usable view in {place}, found none of "
            f"{len(images)}; {notes[0] if notes else 'add images'}."
        )
    try:
        frames = framing.frame_views(
            outlines,
            poses and [poses[path] for path in kept],
            crop=crop,
            fill=fill,
            focal_length=focal_length,
            distance=distance,
        )
    except ValueError as error:
        raise ValueError(f"The poses of {place} cannot be used: {error}.") from None
    pictures = []
    for path, frame in zip(kept, frames, strict=True):
        image, mask = read_image(path)
        pictures.append(framing.cut_frame(image, mask, frame, image_size=image_size))
    arrays = {
        "images": np.stack([image for image, _ in pictures]),
        "masks": np.stack([mask for _, mask in pictures]),
    }
    if poses is not None:
        quaternions = [viewpoints.matrix_to_quaternion(f.rotation) for f in frames]
        arrays["quaternions"] = np.array(quaternions, dtype=np.float32)
    return arrays, notes


def read_image(path):
    """Colours and mask of an image file, upright as its camera noted.

    Returns:
      (uint8 [height, width, 3], float32 [height, width] from 0 to 1).

    Raises:
      ValueError: naming the file, if it or its mask cannot be read, there is no mask,
        the mask has another size, or it is empty or covers the whole image.
    """
    image = _open(path)
    beside = _find_mask(path)
    if beside is not None:
        mask = _open(beside)
        if mask.mode.startswith("I"):  # 16 bits, which Pillow would cut off at 255
            mask = Image.fromarray((np.asarray(mask) >> 8).astype(np.uint8))
        mask = np.asarray(mask.convert("L"))
        if mask.shape != image.size[::-1]:
            raise ValueError(
                f"expected {beside} of the size of {path.name}, {image.size}, got "
                f"{mask.shape[::-1]}; make it again"
            )
    elif image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        mask = np.asarray(image.convert("RGBA"))[..., 3]
    else:
        raise ValueError(
            f"expected an alpha channel in {path} or {path.stem}_mask.png beside it, "
            "found neither; add a mask"
        )
    covered = mask > 127
    if not covered.any() or covered.all():
        extent = "covers the whole image" if covered.any() else "is empty"
        raise ValueError(
            f"expected a mask of the object in {beside or path}, it {extent}; make it "
            "again"
        )
    colors = np.asarray(image.convert("RGBA").convert("RGB"))
    return colors, mask.astype(np.float32) / 255.0


def _find_mask(path):
    for suffix in (".png", *SUFFIXES):
        mask = path.with_name(f"{path.stem}_mask{suffix}")
        if mask.is_file():
            return mask
    return None


def _open(path):
    try:
        with Image.open(path) as image:
            return ImageOps.exif_transpose(image)
    except FAULTS as error:
        raise ValueError(
            f"expected a readable image in {path}, got {type(error).__name__}: {error}"
        ) from None
