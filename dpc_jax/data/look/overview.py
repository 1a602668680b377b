"""What is in a data set: opened from wherever it lies, listed, and drawn."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from dpc_jax import files
from dpc_jax.data import dataset, meshes
from dpc_jax.data.arrays import ROWS, DataSet
from dpc_jax.data.look.checks import Lens, project_points
from dpc_jax.data.sets import released_renders, shapenet
from dpc_jax.data.sets.pictures import SUFFIXES
from dpc_jax.data.spec import DataSpec
from dpc_jax.evaluation.chamfer import find_rows
from dpc_jax.evaluation.rotations import to_rotation

TILE = 128  # pixels of a picture on the sheet
VIEWS = 4  # of an object on the sheet
AXES = ((220, 0, 0), (0, 150, 0), (0, 60, 255))  # colours of front, left and up
LISTED = 5  # skipped models that are named


class OpenSet(NamedTuple):
    """A data set to be looked at; `note` says how it was prepared, if only for that."""

    name: str
    data: DataSet
    lens: Lens
    record: dict[str, Any]
    note: str


@contextlib.contextmanager
def open_set(path: str | Path, *, models: int | None = None) -> Iterator[OpenSet]:
    """Open a cache, or prepare a folder's models for the time of looking.

    `models` limits how many of a folder's models are prepared.
    """
    path = Path(path)
    if (path / dataset.RECORD).is_file():
        yield _read_set(path, path.name, "")
        return
    if not path.is_dir():
        raise ValueError(
            f"Expected a folder with a data set, but {path} is not a folder; check it."
        )
    fields = recognize_folder(path)
    spec = DataSpec(
        **fields, folder=str(path), fractions=(1, 0, 0), models=models, image_size=TILE
    )
    note = f"prepared from {path} ({spec.kind}) to be looked at"
    note += "" if models is None else f", at most {models} models"
    with tempfile.TemporaryDirectory() as place:
        dataset.load_or_render(spec, cache_dir=place)
        (cache,) = Path(place).iterdir()
        yield _read_set(cache, path.name, note)


def _read_set(cache, name, note):
    data, path = dataset.read_cache(cache), cache / dataset.RECORD
    with files.reading("the record of a set", path, "train again to repair it"):
        record = files.read_json(path)
        lens = Lens(record["focal_length"], record["distance"])
    return OpenSet(name, data, lens, record, note)


def recognize_folder(path: Path) -> dict[str, Any]:
    """Fields of a `DataSpec` that fit what a folder holds.

    Raises:
      ValueError: where it holds no models, or several synsets.
    """
    synsets, has_meshes = shapenet.list_synsets(path), bool(meshes.find_meshes(path))
    if len(synsets) > 1:
        raise ValueError(
            f"Expected one synset in {path}, but found {len(synsets)}; give the folder "
            "of one of them."
        )
    if synsets:
        known = {synset: name for name, synset in shapenet.SYNSETS.items()}
        category = known.get(synsets[0], synsets[0])
        if has_meshes:
            return {"kind": "shapenet", "category": category}
        views = released_renders.count_views(shapenet.find_synset(path, synsets[0]))
        return {"kind": "renders", "category": category, "views": views}
    if has_meshes:
        return {"kind": "meshes", "category": "object"}
    if any(file.suffix.lower() in SUFFIXES for file in path.rglob("*")):
        return {"kind": "images", "category": "object"}
    raise ValueError(
        f"Expected a data set, meshes or images in {path}, but found none; give a "
        "folder that holds spec.json, mesh files, or a folder of images per object."
    )


def describe_set(opened: OpenSet) -> list[str]:
    """Lines that say what a set holds."""
    data, record = opened.data, opened.record
    size = data.images.shape[-2]
    present = [name for name in ROWS if getattr(data, name) is not None]
    # All models of a folder are looked at: there is no split yet.
    split = "" if opened.note else f"{record['split']} split, "
    counts = sorted({min(data.counts), max(data.counts)})
    lines = [
        f"{opened.name}: {len(data.names)} {record['category']} models, {split}"
        f"{int(sum(data.counts))} views of {size} x {size} pixels",
        "  views per model: " + " to ".join(map(str, counts)),
        f"  arrays: {', '.join(present)}",
    ]
    if opened.note:
        lines.append(f"  {opened.note}")
    elif record.get("folder"):
        lines.append(f"  made from: {record['folder']}")
    for title, pairs in (("skipped", data.skipped), ("remarks on", data.remarks)):
        if pairs:
            lines.append(f"  {title} {len(pairs)} models:")
            lines += [f"    {name}: {text}" for name, text in pairs[:LISTED]]
    return lines


def draw_set(opened: OpenSet, models: int) -> tuple[Image.Image, list[str]]:
    """Sheet of so many models, spread over the set, and their names.

    Each has a row: images, masks and depths of some of its views. On the images are the
    object's axes: red the front, green the left, blue the top.
    """
    counts, total = opened.data.counts, len(opened.data.names)
    chosen = find_rows(total, min(models, total)).tolist()
    most = min(VIEWS, int(counts.max()))
    rows = []
    for model in chosen:
        seen = [_draw_view(opened, model, v) for v in range(min(most, counts[model]))]
        blank = [np.full_like(seen[0], 255)] * (most - len(seen))
        rows.append(np.concatenate([*seen, *blank], axis=1))
    names = [opened.data.names[model] for model in chosen]
    return Image.fromarray(np.concatenate(rows)), names


def _draw_view(opened, model, view):
    """Image with axes, mask and depth side by side, uint8 [TILE, n TILE, 3]."""
    data, lens = opened.data, opened.lens
    image = _scale(data.images[model][view])
    if data.quaternions is not None:
        _draw_axes(image, data.quaternions[model][view], lens)
    mask = np.asarray(data.masks[model][view])
    tiles = [image, _scale(255 - mask)]
    if data.depths is not None:  # the nearer, the darker
        depth = np.asarray(data.depths[model][view], dtype=np.float64)
        share = np.clip(depth - lens.distance + 0.5, 0.0, 1.0)
        shade = np.where((mask == 0) & (depth == 0), 255, 40 + 180 * share)
        tiles.append(_scale(shade.astype(np.uint8)))
    return np.concatenate([np.asarray(tile) for tile in tiles], axis=1)


def _scale(pixels):
    picture = Image.fromarray(np.asarray(pixels)).convert("RGB")
    smaller = picture.width > TILE
    way = Image.Resampling.BOX if smaller else Image.Resampling.NEAREST
    return picture.resize((TILE, TILE), way)


def _draw_axes(picture, quaternion, lens):
    rotation = to_rotation(quaternion).as_matrix()
    ends = np.concatenate([np.zeros((1, 3)), 0.5 * np.eye(3)])
    places = project_points(ends, rotation[None], lens)[0]
    middle, *tips = (tuple(place * TILE) for place in places)
    for tip, color in zip(tips, AXES, strict=True):
        ImageDraw.Draw(picture).line([middle, tip], fill=color, width=2)
