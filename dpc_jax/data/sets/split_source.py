"""Sources whose models have names: split by a published list, or by seed."""

import abc
import functools
import json
from pathlib import Path
from typing import NamedTuple

from dpc_jax import files
from dpc_jax.data import splits
from dpc_jax.data.sets import split_lists
from dpc_jax.data.sources import Model, Source, complete
from dpc_jax.outputs import show_text


class Division(NamedTuple):
    """Models by name, names by split, and the split file if one was read."""

    models: dict[str, Path]
    sides: dict[str, list[str]]
    official: Path | None


class SplitSource(Source):
    """A folder of models, split by an official list if there is one, or by seed."""

    @property
    def synset(self) -> str:
        """Eight digits of the category in official splits, or "" for none."""
        return ""

    @abc.abstractmethod
    def find_models(self) -> dict[str, Path]:
        """Models that are there: `{name: path}`, in order."""

    def expect_model(self, name: str) -> Path:
        """Where a model that an official split names should lie."""
        return self.folder / name

    @abc.abstractmethod
    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        """(number of views, digest) of a model."""

    def find_split_file(self) -> Path | None:
        """The official split, given or found."""
        return Path(self.spec.split_file) if self.spec.split_file else None

    def split_by_seed(self, names: list[str]) -> dict[str, list[str]]:
        """A split of our own: `{split: names}`."""
        spec = self.spec
        sides = splits.split_files(
            names, fractions=spec.fractions, seed=spec.seed, fold=spec.fold
        )
        return dict(zip(splits.SPLITS, sides, strict=True))

    @functools.cached_property
    def division(self) -> Division:
        """Models and splits, read when first asked for."""
        found = self.find_models()
        models = {show_text(name): path for name, path in found.items()}
        if len(models) < len(found):
            raise ValueError(
                f"Expected names in {self.folder} that differ when they are shown, but "
                "some differ in characters that cannot be shown alone; rename them."
            )
        official = self.find_split_file()
        if official is None:
            return Division(models, self.split_by_seed(list(models)), None)
        if self.spec.fold is not None:
            raise ValueError(
                f"data.fold must be '' where an official split is used, but {official} "
                "is one; leave data.fold out."
            )
        sides = split_lists.read_split(official, self.synset)
        listed = set().union(*sides.values())
        if not listed & models.keys():
            raise ValueError(
                f"Expected {official} to name models of {self.folder}, but none of its "
                f"{len(listed)} is there; give the split file of this set."
            )
        # listed all the same, so that they are counted as damaged
        missing = {name: self.expect_model(name) for name in listed - models.keys()}
        return Division(models | missing, sides, official)

    def list_models(self) -> list[Model]:
        division, spec = self.division, self.spec
        names = division.sides[spec.split]
        if not names:
            raise ValueError(
                f"Expected models for the {spec.split} split of {spec.folder}, but "
                f"there are none among its {len(division.models)}; add models or "
                "change the split."
            )
        models = []
        for name in names:
            path = division.models[name]
            views, digest = self.identify_model(name, path)
            models.append(Model(name, str(path), 0, 0, digest, views))
        return complete(models, spec)

    def list_remarks(self) -> list[tuple[str, str]]:
        models, sides, official = self.division
        unlisted = len(models.keys() - set().union(*sides.values()))
        if official is None or not unlisted:
            return []
        return [(str(official), f"leaves out {unlisted} models of the folder")]

    def write_split(self, cache: Path):
        """Write a seeded split as CATEGORY-split-KEY.csv beside a cache folder."""
        if self.division.official is None:
            sides = self.division.sides
            key = files.digest_text(json.dumps(sides, sort_keys=True))[:12]
            path = cache.with_name(f"{self.spec.category}-split-{key}.csv")
            split_lists.write_split(path, sides, self.synset)
