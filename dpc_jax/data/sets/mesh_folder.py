"""Meshes as a source: files as they are and in stretched copies, procedural shapes."""

import contextlib
import json
import re
from pathlib import Path

import numpy as np
import trimesh

from dpc_jax import files
from dpc_jax.data import meshes, splits
from dpc_jax.data.rendering import render_mesh
from dpc_jax.data.sets import pictures
from dpc_jax.data.sources import Model, Source, complete, list_procedural
from dpc_jax.data.spec import FEW
from dpc_jax.shapes import procedural
from dpc_jax.shapes.normalization import normalize

BARE = "names no materials, rendered grey"
SIDECARS = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".webp")


class MeshSource(Source):
    """A source whose models are meshes, all rendered in the same way."""

    unit = "mesh"
    work = "Rendering"
    is_stretchable = True

    def find_turn(self, path: str) -> np.ndarray | None:
        """Rotation [3, 3] to the canonical frame; None if files are in it already."""
        return None

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        """The normalised mesh of a model."""
        if model.path is None:
            return procedural.make_shape(self.spec.category, model.seed)
        mesh = meshes.read_mesh(model.path)
        turn = self.find_turn(model.path)
        if turn is not None:
            mesh.vertices = mesh.vertices @ turn.T
        if model.copy:
            # normalised first, so that the factors meet sides of comparable length
            seed = [self.spec.seed, model.copy, int(model.digest[:8], 16)]
            mesh = meshes.scale_randomly(normalize(mesh), seed=seed)
        return normalize(mesh)

    def describe_flaws(self, path: str) -> str | None:
        """What a file lacks, though it can be rendered."""
        return describe_flaw(path) if path.lower().endswith(".obj") else None

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
        if model.path is not None and not model.copy:
            flaw = self.describe_flaws(model.path)
        return arrays, [flaw] if flaw else []


class ProceduralShapes(MeshSource):
    """Shapes of a category; no two splits or seeds share one."""

    is_stretchable = False

    def list_models(self) -> list[Model]:
        return list_procedural(self.spec, self.spec.models or 0)


class MeshFolder(MeshSource):
    """Mesh files at any depth of a folder, in the canonical frame, split by seed."""

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        return bool(meshes.find_meshes(folder))

    def list_models(self) -> list[Model]:
        spec, folder = self.spec, self.folder
        if not folder.is_dir():
            raise ValueError(
                f"Expected a folder of mesh files, but {folder} is not a folder; check "
                "it."
            )
        paths = meshes.find_meshes(folder)
        if not paths:
            raise ValueError(
                f"Expected mesh files ({', '.join(meshes.SUFFIXES)}) in {folder}, but "
                "found none; give another folder or convert the files."
            )
        digests = {path: _digest(path) for path in paths}
        bad = self._find_unreadable(digests)
        whole = [path for path in paths if path not in bad] or paths
        sides = splits.split_files(
            whole,
            fractions=spec.fractions,
            seed=spec.seed,
            groups=splits.group_variants(whole, [digests[path] for path in whole]),
            fold=spec.fold,
        )
        # Those that cannot be read are of the largest side, to be named and skipped.
        sides[int(np.argmax(spec.fractions))].extend(set(paths) - set(whole))
        # They come last, so that they take no place where not all are wanted.
        side = sides[splits.SPLITS.index(spec.split)]
        chosen = sorted(side, key=lambda path: (path in bad, path))
        if not chosen:
            raise ValueError(
                f"Expected mesh files for the {spec.split} split of {folder}, but "
                f"there are none ({len(paths)} files split by {spec.fractions}); add "
                "files or change the fractions."
            )
        models = [
            Model(name, str(path), 0, 0, digests[path], spec.views)
            for path in chosen
            if (name := path.relative_to(folder).as_posix())
        ]
        return complete(models, spec)

    def _find_unreadable(self, digests: dict[Path, str]) -> set[Path]:
        """Files that cannot be read, so that no side of a small split is all of them.

        Kept in the cache's folder, because reading all takes a while. In a folder of
        more than `FEW` files, some are of no account.
        """
        if len(digests) > FEW:
            return set()
        names = {path.relative_to(self.folder).as_posix(): path for path in digests}
        facts = [list(names), list(digests.values()), self.list_sidecars()]
        kept = f"unreadable-{files.digest_text(json.dumps(facts))[:12]}.json"
        if self.cache_dir:
            with contextlib.suppress(OSError, ValueError, TypeError):
                known = files.read_json(Path(self.cache_dir) / kept)
                return {names[name] for name in known if name in names}
        bad = [n for n, path in names.items() if not meshes.is_readable(path)]
        if self.cache_dir:
            with contextlib.suppress(OSError):  # nobody depends on it
                files.write_json(Path(self.cache_dir) / kept, bad)
        return {names[name] for name in bad}

    def list_sidecars(self) -> list[tuple[str, str]]:
        found = (p for p in self.folder.rglob("*") if p.suffix.lower() in SIDECARS)
        return [
            (path.relative_to(self.folder).as_posix(), _digest(path))
            for path in sorted(found)
            if path.is_file()
        ]

    def describe_flaws(self, path: str) -> str | None:
        flaw = super().describe_flaws(path)
        # an OBJ file without materials may have colours at its vertices
        return None if flaw == BARE else flaw


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
