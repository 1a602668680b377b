"""Sources of models: what every kind of data set answers about itself.

A new kind is a module in `dpc_jax/data/sets` with a subclass of `Source`, and a line in
`KINDS` of `dpc_jax/data/spec.py`.
"""

import abc
import importlib
from pathlib import Path
from typing import NamedTuple, Protocol

from dpc_jax.data.spec import FEW, KINDS, SEEDS_PER_SPLIT, DataSpec
from dpc_jax.data.splits import SPLITS

PROCEDURAL = "procedural_shapes.ProceduralShapes"  # where a specification has no folder


class Model(NamedTuple):
    """One model of a data set, before its arrays are made.

    name: unique in the data set. path: its file or folder, or None for a procedural
    shape. seed: of a procedural shape. copy: 0 for the original, 1 and above for
    stretched copies. digest: SHA-256 that changes when the model does, or "" where name
    and seed say everything. views: the largest number of views it can have.
    """

    name: str
    path: str | None
    seed: int
    copy: int
    digest: str
    views: int


class Source(Protocol):
    """A kind of data set, opened from its specification.

    Opening is cheap: folders are read when something is asked that needs them, because
    every render process opens the source again.
    """

    spec: DataSpec
    cache_dir: str | Path | None  # where what was found out may be kept
    unit = "object"  # what its models are called in messages
    work = "Reading"  # what is done to make their arrays, likewise
    is_stretchable = False  # whether copies of its models can be stretched

    def __init__(self, spec: DataSpec, cache_dir: str | Path | None = None):
        self.spec = spec
        self.cache_dir = cache_dir

    @property
    def folder(self) -> Path:
        """The folder of the specification."""
        return Path(str(self.spec.folder))

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Whether a folder seems to hold this kind of data set."""
        return False

    @classmethod
    def suggest_fields(cls, folder: Path, category: str | None) -> dict:
        """Fields of a `DataSpec` for somebody who only wants to look at a folder."""
        return {"category": category or "object"}

    @abc.abstractmethod
    def list_models(self) -> list[Model]:
        """All models of the split, in order.

        Raises:
          ValueError: if there are none, naming the folder.
        """

    @abc.abstractmethod
    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        """Arrays of one model by name, and remarks on what it lacks.

        The arrays are images, masks, depths and quaternions with a row per view, and
        surfaces with a row per point (see `DataSet`); some kinds lack some of them. The
        index of the model in the list seeds its views.

        Raises:
          ValueError: naming the file, if the model cannot be used.
        """

    def estimate_bytes(self, model: Model) -> int:
        """Size of a model's arrays."""
        spec = self.spec
        points = spec.surface_points
        if spec.surface_voxel > 0:  # surfaces are about as large as their boxes' sides
            points = min(points, round(2 / spec.surface_voxel**2))
        return 8 * spec.image_size**2 * model.views + 12 * points

    def list_remarks(self) -> list[tuple[str, str]]:
        """(file or folder, remark) pairs on the data set as a whole."""
        return []

    def list_warnings(self) -> list[str]:
        """Sentences on the data set that a reader of results has to know."""
        return []

    def list_sidecars(self) -> list[tuple[str, str]]:
        """(relative path, SHA-256) of files that models share: materials, textures."""
        return []

    def write_split(self, cache: Path):
        """Write a split of our own beside a cache folder, so that it can be reused."""


def find_kind(kind: str | None) -> type[Source]:
    """The `Source` class of a kind in `KINDS`, or of procedural shapes for None."""
    # modules are loaded when they are needed: some import trimesh, others Pillow
    module, name = (PROCEDURAL if kind is None else KINDS[kind]).split(".")
    return getattr(importlib.import_module(f"dpc_jax.data.sets.{module}"), name)


def open_source(spec: DataSpec, cache_dir: str | Path | None = None) -> Source:
    """The source that a specification asks for.

    Raises:
      ValueError: if copies are wanted of what cannot be stretched.
    """
    made = find_kind(None if spec.folder is None else spec.kind)
    if spec.copies > 1 and not made.is_stretchable:
        raise ValueError(
            "copies must be 1 where there are no mesh files to stretch, but it is "
            f"{spec.copies}; set data.copies to 1."
        )
    return made(spec, cache_dir)


def list_procedural(spec: DataSpec, count: int) -> list[Model]:
    """The first procedural shapes of a specification's category, split and seed."""
    first = (spec.seed * len(SPLITS) + SPLITS.index(spec.split)) * SEEDS_PER_SPLIT
    return [
        Model(f"{spec.category}-{seed:07d}", None, seed, 0, "", spec.views)
        for seed in range(first, first + count)
    ]


def complete(models: list[Model], spec: DataSpec) -> list[Model]:
    """Models of files, then their stretched copies, then procedural shapes.

    At most `spec.models` of them.
    """
    count = spec.copies or max(1, round(FEW / len(models)))
    copies = [
        model._replace(name=f"{model.name}#{copy}", copy=copy)
        for copy in range(1, count)
        for model in models
    ]
    mix = spec.mix
    if mix < 0:
        from dpc_jax.shapes.procedural import CATEGORIES  # imports trimesh

        mix = FEW if len(models) < FEW and spec.category in CATEGORIES else 0
    return [*models, *copies, *list_procedural(spec, mix)][: spec.models]
