"""Sources of models: what every kind of data set answers about itself.

A new kind is a module in `dpc_jax/data/sets` with a subclass of `Source`, and a line in
`KINDS` of `dpc_jax/data/spec.py`.
"""

import functools
import importlib
from pathlib import Path
from typing import NamedTuple

from dpc_jax.data import splits
from dpc_jax.data.spec import FEW, KINDS, SEEDS_PER_SPLIT, DataSpec
from dpc_jax.data.splits import FINAL, SPLITS
from dpc_jax.outputs import show_text

# Of the first shape of the split "final" with data.seed = 0, beyond those of others.
_FINAL_SEED = 10**15
PROCEDURAL = "mesh_folder.ProceduralShapes"  # where a specification has no folder


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


class Source:
    """A kind of data set: a folder of models that are split by a list or by seed.

    Folders are read when something is asked that needs them.
    """

    work = "Reading"  # what is done to make the arrays, in messages

    def __init__(self, spec: DataSpec):
        self.spec = spec
        self.remarks: list[tuple[str, str]] = []  # (file or folder, remark on the set)
        self.folder = Path(str(spec.folder))

    def find_models(self) -> dict[str, Path]:
        """Models that are there: `{name: path}`, in order.

        Raises:
          ValueError: if there are none, naming the folder.
        """
        raise NotImplementedError

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        """(number of views, digest) of a model."""
        raise NotImplementedError

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        """Arrays of one model by name, and remarks on what it lacks.

        The arrays are images, masks, depths and quaternions with a row per view, and
        surfaces with a row per point (see `DataSet`); some kinds lack some of them. The
        index of the model in the list seeds its views.

        Raises:
          ValueError: naming the file, if the model cannot be used.
        """
        raise NotImplementedError

    def group_models(self, models: dict[str, Path]) -> list[str] | None:
        """A name for each model; a split parts none that have the same."""
        return None

    def split_models(self, models: dict[str, Path]) -> dict[str, list[str]]:
        """`{split: names}`, by seed; a list of names may have some that are not there.

        Raises:
          ValueError: if the models cannot be split as asked for.
        """
        sides = splits.split_files(
            list(models),
            fractions=self.spec.fractions,
            seed=self.spec.seed,
            groups=self.group_models(models),
            fold=self.spec.fold,
        )
        return dict(zip(SPLITS, sides, strict=True))

    @functools.cached_property
    def models(self) -> dict[str, Path]:
        """Models of all splits by name, read when first asked for."""
        if not self.folder.is_dir():
            raise ValueError(
                f"Expected a folder of {self.spec.kind}, but {self.folder} is not a "
                "folder; check it."
            )
        return {show_text(name): path for name, path in self.find_models().items()}

    @functools.cached_property
    def sides(self) -> dict[str, list[str]]:
        """Names by split, read when first asked for."""
        return self.split_models(self.models)

    def list_models(self) -> list[Model]:
        """Models of the split in order, stretched copies, procedural shapes.

        There are at most `spec.models`.

        Raises:
          ValueError: if there are none, naming the folder.
        """
        spec = self.spec
        names = [name for name in self.sides[spec.split] if name in self.models]
        if not names:
            raise ValueError(
                f"Expected models for the {spec.split} split of {spec.folder}, but "
                f"there are none among its {len(self.models)}; add models or change "
                "the split."
            )
        models = []
        for name in names:
            path = self.models[name]
            views, digest = self.identify_model(name, path)
            models.append(Model(name, str(path), 0, 0, digest, views))
        copies = [
            model._replace(name=f"{model.name}#{copy}", copy=copy)
            for copy in range(1, spec.copies or max(1, round(FEW / len(models))))
            for model in models
        ]
        added = []
        if spec.mix and len(models) < FEW:
            from dpc_jax.shapes.procedural import CATEGORIES  # imports trimesh

            added = list_procedural(spec, FEW if spec.category in CATEGORIES else 0)
        return [*models, *copies, *added][: spec.models]

    def list_warnings(self) -> list[str]:
        """Sentences on the data set that a reader of results has to know."""
        return []

    def list_sidecars(self) -> list[tuple[str, str]]:
        """(relative path, SHA-256) of files that models share: materials, textures."""
        return []


def open_source(spec: DataSpec) -> Source:
    """The source that a specification asks for."""
    # modules are loaded when they are needed: some import trimesh, others Pillow
    place = PROCEDURAL if spec.folder is None else KINDS[spec.kind]
    module, name = place.split(".")
    kind = getattr(importlib.import_module(f"dpc_jax.data.sets.{module}"), name)
    return kind(spec)


def list_procedural(spec: DataSpec, count: int) -> list[Model]:
    """The first procedural shapes of a specification's category, split and seed."""
    if spec.split == FINAL:
        first = _FINAL_SEED + spec.seed * SEEDS_PER_SPLIT
    else:
        first = (spec.seed * len(SPLITS) + SPLITS.index(spec.split)) * SEEDS_PER_SPLIT
    return [
        Model(f"{spec.category}-{seed:07d}", None, seed, 0, "", spec.views)
        for seed in range(first, first + count)
    ]
