"""Chairs and road cars of the package sweethome3d-furniture.

Each library is a zip archive of OBJ files with a catalogue that gives every model a
name, an author and, where its front is not +z, a rotation (y is up).
"""

import re
import zipfile
from pathlib import Path

import numpy as np
import trimesh

from dpc_jax.data import meshes
from dpc_jax.data.open.packages import OpenModel, extract_model, move_vertices

PACKAGE = "sweethome3d-furniture"
CHAIRS = re.compile(r"chair|stool|seat|fotel", re.IGNORECASE)
NO_CHAIRS = re.compile(
    r"wheel ?chair|ottoman|toilet|sofa|lounge|couch|deck|bench|cushion", re.IGNORECASE
)
NO_CARS = re.compile(
    r"truck|bus|scooter|motor|bicycle|bike|fork|boat|helicopter|caravan|stroller|"
    r"tricycle|skateboard|plane|sail|camper|tractor|wheelchair|yamaha",
    re.IGNORECASE,
)
LEFT_OUT = {  # after a look at each
    "BlendSwap-CC-0-foldingChair": "no back",
    "BlendSwap-CC-0-stool2": "no back",
    "BlendSwap-CC-BY-green_stool": "no back",
    "BlendSwap-CC-0-relaxChair": "a lounger",
    "Scopia-beach_chair": "a lounger",
    "BlendSwap-CC-BY-childChair": "like mammut_1 of IKEA's manuals, which others test",
}
FAMILIES = {  # variants of one design; every other model stands alone
    "BlendSwap-CC-0-designChair": "tulip-chair",
    "BlendSwap-CC-0-sillaBlanca": "tulip-chair",
    "KatorLegaz-concept-sedan-01v1": "KatorLegaz-concept-sedan-01",
    "KatorLegaz-concept-sedan-01v2": "KatorLegaz-concept-sedan-01",
    "KatorLegaz-concept-sedan-02": "KatorLegaz-concept-sedan-02",
    "KatorLegaz-concept-sedan-02-sport": "KatorLegaz-concept-sedan-02",
}


def list_models(root: Path, category: str) -> list[OpenModel]:
    """The chairs or cars of the unpacked package, sorted by name.

    The cars are for testing.
    """
    models = []
    for library in sorted(root.rglob("*.sh3f")):
        general, items = _read_catalogue(library)
        for item in items:
            name = f"{library.stem}-{Path(item['model']).stem}"
            label = f"{item.get('name', '')} {Path(item['model']).stem}"
            if name in LEFT_OUT or _classify(label, item) != category:
                continue
            origin = {
                "licence": _name_licence(general.get("license", "")),
                "author": item.get("creator", ""),
                "original": f"{library.relative_to(root)}:{item['model'].lstrip('/')}",
            }
            family = FAMILIES.get(name, name)
            side = "test" if category == "car" else "train"
            models.append(OpenModel(name, family, side, origin, (library, item)))
    return sorted(models)


def _classify(label, item):
    if "ehicle" in item.get("category", ""):
        return None if NO_CARS.search(label) else "car"
    if CHAIRS.search(label) and not NO_CHAIRS.search(label):
        return "chair"
    return None


def _read_catalogue(library):
    """General properties of a library, and the properties of each item."""
    with zipfile.ZipFile(library) as archive:
        text = archive.read("PluginFurnitureCatalog.properties").decode("latin-1")
    general, items = {}, {}
    for line in text.splitlines():
        if match := re.match(r"(\w+)(?:#(\d+))?\s*=(.*)", line):
            key, number, value = match.groups()
            value = re.sub(
                r"\\u([0-9a-fA-F]{4})", lambda m: chr(int(m[1], 16)), value.strip()
            )
            where = general if number is None else items.setdefault(number, {})
            where[key] = value
    return general, [item for item in items.values() if "model" in item]


def _name_licence(text):
    if "ublic domain" in text:
        return "CC0-1.0"
    if "Attribution 3.0" in text:
        return "CC-BY-3.0-US" if "United States" in text else "CC-BY-3.0"
    return text or "see the package's copyright file"


def make_mesh(model: OpenModel, folder: Path) -> trimesh.Trimesh:
    """The mesh of a model in the canonical frame; its files go into `folder`."""
    library, item = model.source
    member = item["model"].lstrip("/")
    mesh = meshes.read_mesh(extract_model(library, member, folder))
    rotation = item.get("modelRotation", "1 0 0 0 1 0 0 0 1")
    turn = np.array(rotation.split(), dtype=np.float64).reshape(3, 3)
    mesh.vertices = np.asarray(mesh.vertices) @ turn.T
    return move_vertices(mesh, (2, 0, 1))  # from y up, front +z
