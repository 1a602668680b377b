"""Meshes as a source: files as they are and in stretched copies, procedural shapes."""

import functools
from pathlib import Path

import numpy as np
import trimesh

from dpc_jax import files
from dpc_jax.data import meshes, splits
from dpc_jax.data.rendering import render_mesh
from dpc_jax.data.sources import Model, Source, list_procedural
from dpc_jax.shapes import procedural
from dpc_jax.shapes.normalization import normalize

# Procedural shapes beside meshes, where they are not those of the category alone.
_MIXED = {"car": "car_simple"}  # meshes of cars are seldom buses and trucks
STRETCH = 0.15  # largest change of an axis in copies of a mesh, as a share of it
SIDECARS = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".webp")


class MeshSource(Source):
    """A source whose models are meshes, all rendered in the same way."""

    work = "Rendering"

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
            rng = np.random.default_rng(
                [self.spec.seed, model.copy, int(model.digest[:8], 16)]
            )
            mesh = normalize(mesh)
            mesh.vertices *= rng.uniform(1 - STRETCH, 1 + STRETCH, 3)
        return normalize(mesh)

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        mesh = self.make_mesh(model)
        arrays = render_mesh(mesh, self.spec, index)
        empty = int((~arrays["masks"].any(axis=(1, 2))).sum())
        if empty:
            raise ValueError(
                f"Expected the object of {model.path or model.name} in all of its "
                f"{self.spec.views} views, but {empty} are empty; one of its "
                "coordinates may lie far off: repair or remove it."
            )
        flaw = mesh.metadata.get("flaw")
        return arrays, [flaw] if flaw and not model.copy else []


class ProceduralShapes(MeshSource):
    """Shapes of a category; no two splits or seeds share one."""

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        return procedural.make_shape(self.spec.category, model.seed)

    def list_models(self) -> list[Model]:
        return list_procedural(self.spec, self.spec.models or 0)


class MeshFolder(MeshSource):
    """Mesh files at any depth of a folder, in the canonical frame, split by seed."""

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
        return {path: _digest(path) for path in self.models.values()}

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        return self.spec.views, self.digests[path]

    def group_models(self, models: dict[str, Path]) -> list[str]:
        """See `Source.group_models`; the variants of a design stay together."""
        paths = list(models.values())
        return splits.group_variants(paths, [self.digests[path] for path in paths])

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
