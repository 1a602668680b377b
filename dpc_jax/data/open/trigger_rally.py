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

PACKAGE = "trigger-rally-data"
PAINT = "_wrc"


def list_models(root: Path, category: str = "car") -> list[OpenModel]:
    """The cars of the unpacked package, sorted by name."""
    archive = root / "usr/share/games/trigger-rally/data.zip"
    with zipfile.ZipFile(archive) as files:
        found = [n for n in files.namelist() if n.endswith(f"{PAINT}.vehicle")]
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
    try:
        tree: Any = xml.etree.ElementTree.parse(path)
        general, part = tree.find("genparams"), tree.find("part")
        body = _read_scaled(path.parent / part.get("model"), float(part.get("scale")))
        size = float(general.get("wheelscale"))
        pieces = [body]
        for item in part.iter("wheel"):
            place = np.array(item.get("pos").split(","), dtype=np.float64)
            radius = float(item.get("radius"))
            wheel = _read_scaled(path.parent / general.get("wheelmodel"), size * radius)
            # its outer side, +x in the file, is turned outwards
            sign = (np.copysign(1.0, place[0]), 1.0, 1.0)
            pieces.append(move_vertices(wheel, scale=sign, shift=place))
    except (xml.etree.ElementTree.ParseError, AttributeError, TypeError) as error:
        raise ValueError(
            f"Expected a vehicle in {path}, but it cannot be read ({error}); repair it."
        ) from error
    # y forward, z up
    joined: Any = trimesh.util.concatenate(pieces)
    return move_vertices(joined, (1, 0, 2), (1.0, -1.0, 1.0))


def _read_scaled(path, scale):
    return move_vertices(meshes.read_mesh(path), scale=scale)
