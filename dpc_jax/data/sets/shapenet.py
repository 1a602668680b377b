"""ShapeNet as users have it on disk, version 1 or 2, brought to the canonical frame.

Version 1 keeps a model in `SYNSET/MODEL/model.obj`, version 2 in
`SYNSET/MODEL/models/model_normalized.obj`. By the read-me files of the two releases
+y is up in both, and the front is +x in version 1 and -z in version 2.
"""

import hashlib
import os
import re
from pathlib import Path

import numpy as np
from PIL import Image

SYNSETS = {"airplane": "02691156", "car": "02958343", "chair": "03001627"}
LAYOUTS = {1: "model.obj", 2: "models/model_normalized.obj"}
FRONTS = {1: "+x", 2: "-z"}
BARE = "names no materials, rendered grey"
TURNS = {  # rows are the canonical axes (front, left, up) in the axes of the file
    "+x": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-x": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "+z": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "-z": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
}


def find_synset(folder, category):
    """(synset, its folder) of a category in a tree, given the tree or that folder.

    Args:
      folder: holds the folders of synsets, or is one of them.
      category: "airplane", "car", "chair", or a synset of eight digits.

    Raises:
      ValueError: naming the folder, if the synset is not there.
    """
    synset = SYNSETS.get(category, category)
    if not re.fullmatch(r"\d{8}", synset):
        raise ValueError(
            f"expected a category of {', '.join(SYNSETS)}, or a synset of eight "
            f"digits, got {category!r}; set config.category."
        )
    folder = Path(folder)
    for place in (folder / synset, folder):
        if place.name == synset and place.is_dir():
            return synset, place
    raise ValueError(
        f"expected the folder {synset} ({category}) in {folder}, found none; give the "
        "folder that ShapeNet's synsets are unpacked in."
    )


def list_models(place):
    """Mesh files of a synset's folder by model id, sorted: `{id: path}`.

    A model that has a folder but no mesh file is listed with the path expected of it,
    so that it is counted among the damaged ones.

    Raises:
      ValueError: naming the folder, if it holds no mesh file in a known layout.
    """
    names = sorted(entry.name for entry in os.scandir(place) if entry.is_dir())
    models, whole = {}, 0
    for name in names:
        paths = [place / name / layout for layout in LAYOUTS.values()]
        found = [path for path in paths if path.is_file()]
        whole += bool(found)
        models[name] = found[-1] if found else paths[0]
    if not whole:
        raise ValueError(
            f"expected MODEL/{' or MODEL/'.join(LAYOUTS.values())} in {place}, found "
            "none; give the folder of ShapeNet version 1 or 2."
        )
    return models


def describe_file(path):
    """A key of a mesh file from name and sizes; contents would take hours to read."""
    path = Path(path)
    sizes = [
        file.stat().st_size if file.is_file() else -1
        for file in (path, path.with_suffix(".mtl"))
    ]
    text = f"{path.parent.parent.name}/{path.parent.name} {sizes}"
    return hashlib.sha256(text.encode()).hexdigest()


def find_turn(path, front=""):
    """Rotation [3, 3] from the axes of a model's file to the canonical frame.

    Args:
      path: of the file; its name tells the version.
      front: "+x", "-x", "+z" or "-z" to say it yourself, or "" for the version's.
    """
    version = 2 if Path(path).as_posix().endswith(LAYOUTS[2]) else 1
    return np.array(TURNS[front or FRONTS[version]], dtype=np.float64)


def describe_materials(path):
    """What a model lacks of materials and textures, in a phrase, or None for nothing.

    The model is rendered all the same, in the plain colours of its materials or grey.
    Textures are missing where they are no pictures, too.
    """
    path = Path(path)
    with open(path, encoding="utf-8", errors="replace") as file:
        text = file.read(1 << 20)  # materials are named before anything uses them
    libraries = re.findall(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE)
    if not libraries:
        return BARE
    found = [path.parent / name for name in libraries if (path.parent / name).is_file()]
    if not found:
        return f"lacks its materials {libraries[0]}, rendered grey"
    content = "\n".join(
        library.read_text(encoding="utf-8", errors="replace") for library in found
    )
    if not re.search(r"^\s*newmtl[ \t]+\S", content, re.MULTILINE):
        return f"has no material in {libraries[0]}, rendered grey"
    images = re.findall(r"^\s*map_Kd[ \t]+(.+?)\s*$", content, re.MULTILINE)
    lost = [name for name in images if not _is_picture(path.parent, name)]
    if lost:
        return f"lacks {len(lost)} of {len(images)} textures, {lost[0]} for one"
    return None


def _is_picture(folder, name):
    """Whether a texture is there and whole."""
    try:
        with Image.open(folder / name.replace("\\", "/")) as picture:
            picture.draft("RGB", (1, 1))  # a small decoding shows a cut file too
            picture.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False
    return True
