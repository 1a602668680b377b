"""Runs: what a row of an experiment trains, at a size, of a category, with a seed."""

import dataclasses
import runpy
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from dpc_jax import config as configs
from dpc_jax.config import Config, from_config_dict
from dpc_jax.experiments.catalogue import find_experiments
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.sizes import RESOLUTIONS, SIZES, Size

_POINTS = "render.num_points"
# Of each mesh of the open sets, which are few (docs/log.md).
_COPIES = {"car": 12, "chair": 6, "airplane": 4}
TOO_LONG = "too long for this size"
NO_FIXED_VIEWS = "renders have no views from fixed places"


@dataclasses.dataclass(frozen=True)
class Source:
    """Where the objects come from.

    Attributes:
      kind: "procedural", "open", "shapenet" or "renders".
      folder: that the kind needs; "" for procedural shapes.
    """

    kind: str = "procedural"
    folder: str = ""

    def list_changes(self, category: str) -> dict[str, Any]:
        """What a config of that category differs in.

        Raises:
          ValueError: where the category is not in the folder.
        """
        if self.kind == "procedural":
            return {}
        folder = Path(self.folder).absolute()
        if self.kind != "open":
            # Loads trimesh, which nothing else needs here.
            from dpc_jax.data.sets.shapenet import find_synset

            find_synset(folder, category)
            return {f"data.{self.kind}": str(folder)}
        meshes = folder / category / "train"
        if not meshes.is_dir():
            raise ValueError(
                f"Expected meshes of the category in {meshes}, but there is no such "
                f"folder; fetch them with: launch/data.sh fetch {category}."
            )
        copies = _COPIES.get(category, 1)
        # Systems are compared on the meshes alone.
        changes = {"data.meshes": str(meshes), "data.copies": copies, "data.mix": 0}
        tested = folder / category / "test"
        return changes | ({"data.test_meshes": str(tested)} if tested.is_dir() else {})


@dataclasses.dataclass(frozen=True)
class Run:
    """One training run, and where in DIR it lies.

    Attributes:
      name: of its folder; runs of the same config have the same.
      variant: the text after the colon of --config.
      changes: ("section.field", value) to set after the variant.
    """

    name: str
    category: str
    variant: str
    seed: int
    changes: tuple[tuple[str, Any], ...]

    @property
    def config_path(self) -> Path:
        """The config file."""
        return configs.list_shipped()[self.category]

    def list_flags(self) -> list[str]:
        """Flags for `dpc_jax.main`."""
        config = f"{self.config_path}:{self.variant}".rstrip(":")
        fields = {"seed": self.seed} | dict(self.changes)
        flags = [f"--config.{name}={value}" for name, value in fields.items()]
        return [f"--config={config}", *flags]

    def load_config(self) -> Config:
        """The config that these flags stand for, after all its checks.

        Raises:
          ValueError: for a config that cannot work, or a file that is not there.
        """
        try:
            module = runpy.run_path(str(self.config_path))
            edited = module["get_config"](self.variant or None)
            edited.seed = self.seed
            for name, value in self.changes:
                edited.update_from_flattened_dict({name: value})
        except OSError as error:
            raise ValueError(
                f"Expected the config {self.config_path}, but it cannot be read "
                f"({error.strerror}); install the package again."
            ) from None
        except TypeError as error:
            raise ValueError(
                f"The run {self.name} must set fields to values of their types, but it "
                f"does not ({str(error.args[0]).splitlines()[0]}); correct its row in "
                "dpc_jax/experiments/catalogue.py."
            ) from None
        config = from_config_dict(edited)
        configs.check(config)
        return config


def declare_run(row: Row, category: str, seed: int, size: Size, source: Source) -> Run:
    """The run of a row.

    Raises:
      ValueError: for a row without variant, or a missing folder.
    """
    if row.variant is None:
        raise ValueError(
            f"Row {row.label!r} must name a variant to be trained, but it has none; "
            "it is measured on the data."
        )
    own = dict(row.changes)
    if _POINTS in own:
        own[_POINTS] = max(own[_POINTS] // size.fewer_points, 4)
    shared = source.list_changes(category) | dict(size.changes)
    usual = size.budgets[find_resolution(row)]
    budget = size.budgets[row.budget] if row.budget else usual
    shared |= budget
    variant = ",".join(part for part in (size.variant, row.variant) if part)
    parts = (category, *variant.split(","), row.tag)
    parts += (row.budget if budget != usual else "", f"seed{seed}")
    return Run(
        name="-".join(part for part in parts if part),
        category=category,
        variant=variant,
        seed=seed,
        changes=tuple((shared | own).items()),
    )


def find_resolution(row: Row) -> str:
    """The variant of a row that sets the side of images and volume; "" for none."""
    named = set((row.variant or "").split(",")) & set(RESOLUTIONS)
    return named.pop() if named else ""


@dataclasses.dataclass(frozen=True)
class Request:
    """What one command asks for.

    Attributes:
      experiment: names with commas between, or "all".
      size: name of a size.
      source: where objects come from.
      categories, seeds: empty for those of the size.
    """

    experiment: str = "all"
    size: str = "cpu"
    source: Source = Source()
    categories: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()

    def write_command(self) -> str:
        """The command line, without what says where things lie."""
        flags = {"experiment": self.experiment, "size": self.size}
        if self.source.kind != "procedural":
            flags |= {"source": self.source.kind, "folder": "DIR"}
        flags["category"] = ",".join(self.categories)
        flags["seeds"] = ",".join(map(str, self.seeds))
        words = [f"--{name}={value}" for name, value in flags.items() if value]
        return " ".join(["python -m dpc_jax.paper", *words])

    def list_experiments(self) -> tuple[Experiment, ...]:
        """The experiments asked for, those that have no category asked for left out."""
        found = find_experiments(self.experiment)
        return tuple(e for e in found if self.list_categories(e))

    def list_categories(self, experiment: Experiment) -> tuple[str, ...]:
        """Categories of an experiment, in the paper's order."""
        asked = self.categories or SIZES[self.size].categories
        return tuple(c for c in experiment.categories if c in asked)

    def list_seeds(self, row: Row) -> tuple[int, ...]:
        """Seeds of a row."""
        size = SIZES[self.size]
        is_long = row.is_long or find_resolution(row) == RESOLUTIONS[-1]
        return self.seeds or (size.long_seeds if is_long else size.seeds)

    def explain_absence(self, row: Row) -> str:
        """Why a row that is trained is left out; "" where it is not."""
        if row.tag in SIZES[self.size].left_out:
            return TOO_LONG
        is_of_maps = "epcg" in (row.variant or "").split(",")
        return NO_FIXED_VIEWS if is_of_maps and self.source.kind == "renders" else ""

    def list_row_runs(self, row: Row, category: str) -> list[Run]:
        """Runs of a row, one per seed; none of what size or source leave out."""
        if row.variant is None or self.explain_absence(row):
            return []
        size = SIZES[self.size]
        return [
            declare_run(row, category, seed, size, self.source)
            for seed in self.list_seeds(row)
        ]


def list_runs(requests: Iterable[Request]) -> list[Run]:
    """All runs of requests, each once; the first seeds of all come before the others.

    So that every table has its first numbers early.

    Raises:
      ValueError: where two rows name different runs alike.
    """
    declared = [
        run
        for request in requests
        for experiment in request.list_experiments()
        for category in request.list_categories(experiment)
        for row in experiment.rows
        for run in request.list_row_runs(row, category)
    ]
    by_name = {}
    for run in declared:
        if by_name.setdefault(run.name, run) != run:
            raise ValueError(
                f"Runs of the name {run.name} must have one config, but two rows "
                "differ in theirs; give one of them another tag."
            )
    return sorted(by_name.values(), key=lambda run: run.seed)


def choose_runs(request: Request, only: Sequence[str]) -> list[Run]:
    """The runs of a request whose names fit one of the patterns.

    Raises:
      ValueError: where one pattern fits none.
    """
    runs = list_runs([request])
    for pattern in only:
        if not any(fnmatchcase(run.name, pattern) for run in runs):
            raise ValueError(
                "--only must name runs of the request, but "
                f"{pattern or 'an empty name'} fits none of its {len(runs)}; write for "
                f"example --only={runs[0].name}."
            )
    return [run for run in runs if any(fnmatchcase(run.name, p) for p in only)]
