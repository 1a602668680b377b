"""Which trainings an experiment needs: of each row, at a size, by category and seed.

A value that a size says replaces that of the config after its variant. Where a row says
a value itself, that one counts.
"""

import dataclasses
import runpy
from collections.abc import Mapping
from typing import Any

from dpc_jax import config as configs
from dpc_jax.config import Config, from_fields
from dpc_jax.experiments.catalogue import (
    CATEGORIES,
    EXPERIMENTS,
    NAMES,
    SHIPPED,
    Experiment,
    Row,
)

# What shortens the variant "paper" to minutes or an hour of a CPU core (docs/paper.md).
_REDUCED = {
    "data.models": 1000,  # the data of the default runs, so that tables compare
    "data.val_models": 40,
    "data.test_models": 100,
    "data.copies": 0,
    "data.surface_points": 10_000,
    "data.surface_voxel": 0.0,
    "network.hidden": 512,
    "network.shape_hidden": 512,
    "log.every": 100,
    "log.evaluate": 1000,
    "log.checkpoint": 1000,
}
RESOLUTIONS = ("32", "64", "128")  # variants: side of images and volume
# Images of 64 pixels in a volume of 32³, with as many points as the paper has there.
_COARSE = {"render.grid": 32, "render.num_points": 2000}


@dataclasses.dataclass(frozen=True)
class Size:
    """How large the runs of a --size are."""

    categories: tuple[str, ...]  # unless others are asked for
    seeds: tuple[int, ...]
    # "section.field": value, of every run
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # The same of runs of the paper's method alone, which have the variant "paper".
    method: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # The same for runs of a budget: the variant of `RESOLUTIONS` that they have, or
    # what their row says; "" for others.
    budgets: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
    left_out: frozenset[str] = frozenset()  # tags of rows whose runs take too long
    fewer_points: int = 1  # numbers of points that rows say are divided by this
    # Variables of the runs' processes
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)


SIZES = {
    "quick": Size(
        categories=("chair",),  # programs do not depend on the category
        seeds=(0,),  # shows that all runs, not how well
        changes={
            "data.models": 12,  # rendered in seconds
            "data.val_models": 4,
            "data.test_models": 4,
            "data.surface_points": 2000,  # Chamfer distances in milliseconds
            "data.surface_voxel": 0.0,
            "network.channels": 4,
            "network.hidden": 32,
            "network.shape_hidden": 32,
            "render.keep_start": 1.0,  # one stage, one program to compile
            "render.keep_end": 1.0,
            "render.num_points": 200,
            "pose.choice_top": 0,
            "train.steps": 10,  # enough to log, validate, save
            "log.every": 5,
            "log.evaluate": 0,  # the last step has one anyhow
        },
        budgets={
            # Images of half the side named, the least that the encoder takes, and
            # volumes of a quarter.
            "32": {"data.image_size": 16, "render.grid": 8},
            "64": {"data.image_size": 32, "render.grid": 16},
            "128": {"data.image_size": 64, "render.grid": 32},
            "points": {"data.image_size": 32, "render.grid": 16},
            **dict.fromkeys(
                ("", "signals", SHIPPED),
                {"data.image_size": 32, "render.grid": 16, "render.fine_grid": 0},
            ),
        },
        fewer_points=20,
        # Programs run for seconds: compiling them takes 11 s of a core instead of 23.
        environment={"JAX_DISABLE_MOST_OPTIMIZATIONS": "true"},
    ),
    "cpu": Size(
        categories=CATEGORIES,
        seeds=(0, 1, 2),  # a spread needs three
        method=_REDUCED,
        budgets={
            # The same steps at every resolution: a column of Table 1 differs in nothing
            # else.
            **dict.fromkeys(RESOLUTIONS, {"train.steps": 5000}),
            # A render of 200 covariances takes 70 ms: four minutes and a half a run.
            "points": {"train.steps": 1000, "train.views_per_batch": 2},
            # A render with colours takes four to six times as long as one without.
            "signals": _COARSE | {"train.steps": 4000},
            "": _COARSE | {"train.steps": 20_000},
        },
        left_out=frozenset({"covariance2000"}),  # an hour by their renders
    ),
    "full": Size(
        categories=CATEGORIES,  # § Datasets
        seeds=(0,),  # the paper names none; a run takes days
    ),
}


@dataclasses.dataclass(frozen=True)
class Run:
    """One training run."""

    name: str  # of its folder; runs of the same config have the same
    category: str
    variant: str  # the text after the colon of --config
    seed: int
    changes: tuple[tuple[str, Any], ...]  # ("section.field", value), after the variant

    def list_flags(self) -> list[str]:
        """Flags for `dpc_jax.main`."""
        config = f"{self.category}:{self.variant}".rstrip(":")
        fields = {"seed": self.seed} | dict(self.changes)
        flags = [f"--config.{name}={value}" for name, value in fields.items()]
        return [f"--config={config}", *flags]

    def load_config(self) -> Config:
        """The config that these flags stand for; ValueError where it cannot work."""
        module = runpy.run_path(str(configs.list_shipped()[self.category]))
        edited = module["get_config"](self.variant or None)
        edited.update_from_flattened_dict({"seed": self.seed} | dict(self.changes))
        config = from_fields(edited.to_dict())
        configs.check(config)
        return config


def find_resolution(row: Row) -> str:
    """The variant of a row that sets the side of images and volume; "" for none."""
    named = set(row.variant.split(",")) & set(RESOLUTIONS)
    return named.pop() if named else ""


@dataclasses.dataclass(frozen=True)
class Request:
    """What one command asks for."""

    names: tuple[str, ...] = NAMES  # of experiments
    size: str = "cpu"  # of `SIZES`
    shapenet: str = ""  # its folder; empty for procedural shapes
    categories: tuple[str, ...] = ()  # empty for those of the size
    seeds: tuple[int, ...] = ()  # empty for those of the size

    def list_experiments(self) -> list[Experiment]:
        """The experiments, but for those that no category asked for has."""
        found = [e for e in EXPERIMENTS if e.name in self.names]
        return [e for e in found if self.list_categories(e)]

    def list_categories(self, experiment: Experiment) -> list[str]:
        """Categories of an experiment, in the paper's order."""
        asked = self.categories or SIZES[self.size].categories
        return [c for c in experiment.categories if c in asked]

    def list_seeds(self, row: Row) -> tuple[int, ...]:
        """Seeds of a row; one where a run takes over ten minutes at the size "cpu"."""
        size = SIZES[self.size]
        is_long = row.is_long or find_resolution(row) in RESOLUTIONS[2:]
        return self.seeds or (size.seeds[:1] if is_long else size.seeds)

    def list_row_runs(self, row: Row, category: str) -> list[Run]:
        """Runs of a row, one per seed; none of what is left out."""
        if row.tag in SIZES[self.size].left_out:
            return []
        return [declare_run(row, category, s, self) for s in self.list_seeds(row)]

    def list_runs(self) -> list[Run]:
        """All runs, each once; the first seeds of all come before the others."""
        found = {
            run.name: run
            for experiment in self.list_experiments()
            for category in self.list_categories(experiment)
            for row in experiment.rows
            for run in self.list_row_runs(row, category)
        }
        return sorted(found.values(), key=lambda run: run.seed)


def declare_run(row: Row, category: str, seed: int, request: Request) -> Run:
    """The run of a row that is trained."""
    size, points = SIZES[request.size], "render.num_points"
    own = dict(row.changes)
    if points in own:
        own[points] = max(own[points] // size.fewer_points, 4)
    usual = size.budgets.get(find_resolution(row), {})
    budget = size.budgets.get(row.budget, {}) if row.budget else usual
    is_paper = row.budget != SHIPPED
    shared = dict(size.method if is_paper else {}) | dict(size.changes) | dict(budget)
    if request.shapenet:
        shared["data.shapenet"] = request.shapenet
    elif category == "car":
        shared["category"] = "car_simple"  # the paper's cars are passenger cars
    method = "paper" if is_paper else ""
    variant = ",".join(part for part in (method, row.variant) if part)
    parts = (category, *variant.split(","), row.tag)
    parts += (row.budget if budget != usual else "", f"seed{seed}")
    name = "-".join(part for part in parts if part)
    return Run(name, category, variant, seed, tuple((shared | own).items()))
