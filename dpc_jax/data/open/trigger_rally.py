"""Cars of the package trigger-rally-data, a racing game: three bodies with wheels.

The package has each body in three paints; the one of the highest class is taken.
"""

import xml.etree.ElementTree
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dpc_jax.data import meshes
from dpc_jax.data.open.packages import OpenModel, extract_model, move_vertices
from dpc_jax.files import reading

PACKAGE = "trigger-rally-data"
PAINT = "_wrc"


def list_models(root: Path, category: str = "car") -> list[OpenModel]:
    """The cars of the unpacked package, sorted by name."""
    archive = root / "usr/share/games/trigger-rally/data.zip"
    with zipfile.ZipFile(archive) as content:
        found = [n for n in content.namelist() if n.endswith(f"{PAINT}.vehicle")]
    models = []
    for member in found:
        name = f"trigger-rally-{Path(member).stem.removesuffix(PAINT)}"
        origin = {
            "licence": "GPL-2.0-or-later",
            "author": "Jasmine Langridge, Richard Langridge and contributors",
            "original": f"{archive.relative_to(root)}:{member}",
        }
        models.append(OpenModel(name, name, "train", origin, (archive, member)))
    return sorted(models)


def make_mesh(model: OpenModel, folder: Path) -> trimesh.Trimesh:
    """The mesh of a car with its wheels in the canonical frame; unpacks to `folder`."""
    archive, member = model.source
    path = extract_model(archive, member, folder)
    with reading("a vehicle", path):
        tree: Any = xml.etree.ElementTree.parse(path)
        general, part = tree.find("genparams"), tree.find("part")
        body = path.parent / part.get("model"), float(part.get("scale"))
        file = path.parent / general.get("wheelmodel")
        size = float(general.get("wheelscale"))
        wheels = [
            (np.array(item.get("pos").split(","), float), float(item.get("radius")))
            for item in part.iter("wheel")
        ]
    pieces = [_read_scaled(*body)]
    for place, radius in wheels:
        wheel = _read_scaled(file, size * radius)
        # its outer side, +x in the file, is turned outwards
        sign = (np.copysign(1.0, place[0]), 1.0, 1.0)
        pieces.append(move_vertices(wheel, scale=sign, shift=place))
    # y forward, z up
    joined: Any = trimesh.util.concatenate(pieces)
    return move_vertices(joined, (1, 0, 2), (1.0, -1.0, 1.0))


def _read_scaled(path, scale):
    return move_vertices(meshes.read_mesh(path), scale=scale)
