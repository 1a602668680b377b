"""Meshes as a source: files as they are and in stretched copies, procedural shapes."""

import contextlib
import functools
import re
from pathlib import Path

import numpy as np
import trimesh

from dpc_jax import files
from dpc_jax.data import meshes, splits
from dpc_jax.data.rendering import render_mesh
from dpc_jax.data.sets import pictures
from dpc_jax.data.sources import Model, Source, list_procedural
from dpc_jax.data.spec import FEW
from dpc_jax.shapes import procedural
from dpc_jax.shapes.normalization import normalize

BARE = "names no materials, rendered grey"
# Procedural shapes beside meshes, where they are not those of the category alone.
_MIXED = {"car": "car_simple"}  # meshes of cars are seldom buses and trucks
SIDECARS = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".webp")


class MeshSource(Source):
    """A source whose models are meshes, all rendered in the same way."""

    unit = "mesh"
    work = "Rendering"
    remarks_on_bare = True  # whether a file without materials lacks something

    def find_turn(self, path: str) -> np.ndarray | None:
        """Rotation [3, 3] to the canonical frame; None if files are in it already."""
        return None

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        """The normalised mesh of a model."""
        if model.path is None:
            category = self.spec.category
            return procedural.make_shape(_MIXED.get(category, category), model.seed)
        mesh = meshes.read_mesh(model.path)
        turn = self.find_turn(model.path)
        if turn is not None:
            mesh.vertices = mesh.vertices @ turn.T
        if model.copy:
            # normalised first, so that the factors meet sides of comparable length
            seed = [self.spec.seed, model.copy, int(model.digest[:8], 16)]
            mesh = meshes.scale_randomly(normalize(mesh), seed=seed)
        return normalize(mesh)

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        arrays = render_mesh(self.make_mesh(model), self.spec, index)
        empty = int((~arrays["masks"].any(axis=(1, 2))).sum())
        if empty:
            raise ValueError(
                f"Expected the object of {model.path or model.name} in all of its "
                f"{self.spec.views} views, but {empty} are empty; one of its "
                "coordinates may lie far off: repair or remove it."
            )
        flaw = None
        if model.path and not model.copy and model.path.lower().endswith(".obj"):
            flaw = describe_flaw(model.path)
        return arrays, [flaw] if flaw and (flaw != BARE or self.remarks_on_bare) else []


class ProceduralShapes(MeshSource):
    """Shapes of a category; no two splits or seeds share one."""

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        return procedural.make_shape(self.spec.category, model.seed)

    def list_models(self) -> list[Model]:
        return list_procedural(self.spec, self.spec.models or 0)


class MeshFolder(MeshSource):
    """Mesh files at any depth of a folder, in the canonical frame, split by seed."""

    remarks_on_bare = False  # an OBJ file may have colours at its vertices

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        return bool(meshes.find_meshes(folder))

    def find_models(self) -> dict[str, Path]:
        paths = meshes.find_meshes(self.folder)
        if not paths:
            raise ValueError(
                f"Expected mesh files ({', '.join(meshes.SUFFIXES)}) in {self.folder}, "
                "but found none; give another folder or convert the files."
            )
        return {path.relative_to(self.folder).as_posix(): path for path in paths}

    @functools.cached_property
    def digests(self) -> dict[Path, str]:
        """Digest of each file of the folder."""
        return {path: _digest(path) for path in meshes.find_meshes(self.folder)}

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        return self.spec.views, self.digests[path]

    def split_by_seed(self, models: dict[str, Path]) -> dict[str, list[str]]:
        """See `Source.split_by_seed`; the variants of a design stay together."""
        names, digests = {path: name for name, path in models.items()}, self.digests
        whole = list(names)
        if len(names) <= FEW:  # that no side of a small split is all unreadable files
            whole = [p for p in names if meshes.is_readable(p, digests[p])] or whole
        sides = splits.split_files(
            whole,
            fractions=self.spec.fractions,
            seed=self.spec.seed,
            groups=splits.group_variants(whole, [digests[path] for path in whole]),
            fold=self.spec.fold,
        )
        # Those that cannot be read are of the largest side, to be named and skipped,
        # and last, so that they take no place where not all are wanted.
        largest = sides[int(np.argmax(self.spec.fractions))]
        largest.extend(sorted(set(names) - set(whole)))
        found = ([names[path] for path in side] for side in sides)
        return dict(zip(splits.SPLITS, found, strict=True))

    def list_sidecars(self) -> list[tuple[str, str]]:
        found = (p for p in self.folder.rglob("*") if p.suffix.lower() in SIDECARS)
        return [
            (path.relative_to(self.folder).as_posix(), _digest(path))
            for path in sorted(found)
            if path.is_file()
        ]


def _digest(path: Path) -> str:
    """SHA-256 of a file; of none that cannot be opened."""
    try:
        return files.digest_file(path)
    except OSError as error:
        return files.digest_text(f"{path.name}: {files.describe_error(error)}")


def describe_flaw(path: str | Path) -> str | None:
    """What an OBJ file lacks of materials and textures, or None for nothing.

    The model is rendered all the same, in the plain colours of its materials or in
    grey. A texture that is no readable picture counts as missing.
    """
    path = Path(path)
    with files.open_regular(path) as file:
        head = file.read(1 << 20)  # materials are named before anything uses them
    text = head.decode("utf-8", errors="replace")
    libraries = re.findall(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE)
    if not libraries:
        return BARE
    content = _read_materials(path, libraries)
    if content is None:
        return f"lacks its materials {libraries[0]}, rendered grey"
    if not re.search(r"^\s*newmtl[ \t]+\S", content, re.MULTILINE):
        return f"has no material in {libraries[0]}, rendered grey"
    images = re.findall(r"^\s*map_Kd[ \t]+(.+?)\s*$", content, re.MULTILINE)
    places = [meshes.find_beside(path, name) for name in images]
    lost = [
        name
        for name, place in zip(images, places, strict=True)
        if place is None or not pictures.is_readable(place)
    ]
    if lost:
        return f"lacks {len(lost)} of {len(images)} textures, {lost[0]} for one"
    return None


def _read_materials(path, libraries):
    """Text of all material files that can be read; None where there is none."""
    found = []
    for name in libraries:
        if place := meshes.find_beside(path, name):
            with contextlib.suppress(OSError):
                found.append(files.read_bytes(place, most=files.MOST_TEXT))
    return "\n".join(map(meshes.decode_text, found)) if found else None
