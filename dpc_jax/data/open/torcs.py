"""Cars of the package torcs-data, a racing game: bodies with their wheels put on.

A body has no wheels; the car's parameters say where they are and how large. What a car
leaves out is in the parameters of its category.
"""

import re
import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dpc_jax.data import meshes
from dpc_jax.data.open import ac3d
from dpc_jax.data.open.packages import OpenModel, move_vertices
from dpc_jax.files import reading

PACKAGE = "torcs-data"
UNITS = {"m": 1.0, "": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
WHEEL = "trb1-5"  # where a car names no model of its wheels
GPL = ("155-DTM", "buggy", "p406")  # by the package's copyright file
FAMILIES = {"car1-trb3": "torcs-car1-trb1"}  # the same body without its wing


def list_models(root: Path, category: str = "car") -> list[OpenModel]:
    """The cars of the unpacked package, sorted by name."""
    game = root / "usr/share/games/torcs"
    models = []
    for folder in game.glob("cars/*"):
        name, path = folder.name, folder / f"{folder.name}.acc"
        if not path.is_file():
            continue
        origin = {
            "licence": "GPL-2.0-or-later" if name in GPL else "FAL-1.3",
            "author": _read_authors(folder / "readme.txt"),
            "original": str(path.relative_to(root)),
        }
        family = FAMILIES.get(name, f"torcs-{name}")
        source = (path, game)
        models.append(OpenModel(f"torcs-{name}", family, "train", origin, source))
    return sorted(models)


def _read_authors(path):
    """The copyright lines of a readme, or the package's own."""
    text = meshes.decode_text(path.read_bytes()) if path.is_file() else ""
    lines = re.findall(r"Copyright\s+(.*)", text)
    return "; ".join(line.strip() for line in lines) or "the TORCS team"


def make_mesh(model: OpenModel, folder: Path) -> trimesh.Trimesh:
    """The mesh of a car with its wheels in the canonical frame."""
    path, game = model.source
    own = _read_parameters(path.with_suffix(".xml"))
    general = {}
    if "Car/category" in own:
        general = _read_parameters(game / f"categories/{own['Car/category']}.xml")
    values = {**general, **own}
    wheel = values.get("Graphic Objects/3d wheel directory", WHEEL)
    wheel = _read_turned(game / f"wheels/{wheel}/wheel0.acc")
    pieces = [_read_turned(path)]
    with reading("the places of wheels", path.with_suffix(".xml")):
        pieces += [
            _place_wheel(wheel, values, f"{end} {side} Wheel", f"{end} Axle")
            for end in ("Front", "Rear")
            for side in ("Right", "Left")
        ]
    joined: Any = trimesh.util.concatenate(pieces)
    return joined


def _read_turned(path):
    """A mesh, which has x forward and y up in its file, in the canonical frame."""
    mesh = ac3d.join_parts(ac3d.read_parts(path))
    return move_vertices(mesh, (0, 2, 1), (1.0, -1.0, 1.0))


def _place_wheel(wheel, values, name, axle):
    """A copy of the unit wheel in its place; its outer side is turned outwards."""
    width = values[f"{name}/tire width"]
    radius = (
        values[f"{name}/rim diameter"] / 2
        + width * values[f"{name}/tire height-width ratio"]
    )
    left = values[f"{name}/ypos"]
    place = (values[f"{axle}/xpos"], left, radius - values[f"{name}/ride height"])
    scale = (2 * radius, np.copysign(width, left), 2 * radius)
    return move_vertices(wheel.copy(), scale=scale, shift=place)


def _read_parameters(path):
    """{"Section/name": value} of a parameter file, lengths in metres."""
    with reading("parameters of a car", path):
        # entities, which only include other files of the game, are not needed
        text = re.sub(rb"&[\w-]+;", b"", path.read_bytes())
        tree = xml.etree.ElementTree.fromstring(text)
    values = {}
    for section in tree.iter("section"):
        for item in section:
            key = f"{section.get('name')}/{item.get('name')}"
            if item.tag == "attstr":
                values[key] = item.get("val")
            elif item.tag == "attnum" and item.get("unit", "") in UNITS:
                values[key] = float(item.get("val", "")) * UNITS[item.get("unit", "")]
    return values
