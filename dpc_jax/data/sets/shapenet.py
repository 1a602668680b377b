"""ShapeNet as users have it on disk, version 1 or 2, brought to the canonical frame.

Version 1 keeps a model in `SYNSET/MODEL/model.obj`, version 2 in
`SYNSET/MODEL/models/model_normalized.obj`. By the read-me files of the two releases
+y is up in both, and the front is +x in version 1 and -z in version 2.
"""

import functools
import os
import re
from pathlib import Path

import numpy as np

from dpc_jax import files
from dpc_jax.data import splits
from dpc_jax.data.sets.mesh_folder import MeshSource
from dpc_jax.data.sources import Source
from dpc_jax.data.splits import SPLITS

SYNSETS = {"airplane": "02691156", "car": "02958343", "chair": "03001627"}
LAYOUTS = {1: "model.obj", 2: "models/model_normalized.obj"}
# Models to train on, validate on and test on in the split that published results share
# (of the ray consistency papers; released beside the paper's code). Its text file of
# chairs lists one validation model less than its table.
OFFICIAL = {
    "02691156": ((2831, 404, 810),),
    "02958343": ((5247, 750, 1500),),
    "03001627": ((4744, 678, 1356), (4744, 677, 1356)),
}
TURNS = {  # rows are the canonical axes (front, left, up) in the axes of the file
    1: np.array([(1.0, 0, 0), (0, 0, -1), (0, 1, 0)]),
    2: np.array([(0.0, 0, -1), (-1, 0, 0), (0, 1, 0)]),
}


class SynsetSource(Source):
    """A source that keeps each category in the folder of its synset."""

    @functools.cached_property
    def place(self) -> Path:
        """The folder of the synset."""
        return find_synset(self.folder, self.spec.category)

    @property
    def synset(self) -> str:
        return self.place.name

    @functools.cached_property
    def official(self) -> Path | None:
        """The file of the official split, where one lies in the folder."""
        return splits.find_split(self.folder, self.synset)

    def split_models(self, models: dict[str, Path]) -> dict[str, list[str]]:
        """See `Source.split_models`; as the official split says, if there is one."""
        if self.official is None:
            return super().split_models(models)
        if self.spec.fold is not None:
            raise ValueError(
                "data.fold must be '' where an official split is used, but "
                f"{self.official} is one; leave data.fold out."
            )
        sides = splits.read_split(self.official, self.synset)
        listed = set().union(*sides.values())
        if not listed & models.keys():
            raise ValueError(
                f"Expected {self.official} to name models of {self.folder}, but none "
                f"of its {len(listed)} is there; give the split file of this set."
            )
        unlisted, absent = len(models.keys() - listed), len(listed - models.keys())
        parts = [f"leaves out {unlisted} models of the folder"] * bool(unlisted)
        parts += [f"names {absent} that are not there"] * bool(absent)
        if parts:
            self.remarks.append((str(self.official), " and ".join(parts)))
        return sides

    def list_warnings(self) -> list[str]:
        """Whether the split is another one than that of published results."""
        counts = tuple(
            sum(name in self.models for name in self.sides[split]) for split in SPLITS
        )
        known = OFFICIAL.get(self.synset)
        if self.official is not None and (known is None or counts in known):
            return []
        found = "{:,}, {:,} and {:,} models".format(*counts)
        name = f"by {self.official}" if self.official else f"by seed {self.spec.seed}"
        text = f"{self.folder} is split {name} (train, val, test: {found})"
        other = "an official list"
        if known:
            other = "the official list ({:,}, {:,}, {:,})".format(*known[0])
        return [
            f"{text}, not by {other}: the figures cannot be compared with "
            "published ones."
        ]


class ShapeNet(SynsetSource, MeshSource):
    """ShapeNet's meshes, rendered."""

    def find_models(self) -> dict[str, Path]:
        place, models, whole = self.place, {}, 0
        for name in sorted(entry.name for entry in os.scandir(place) if entry.is_dir()):
            paths = [place / name / layout for layout in LAYOUTS.values()]
            found = [path for path in paths if path.is_file()]
            whole += bool(found)
            # without a file it is listed too, and counted among the damaged ones
            models[name] = found[-1] if found else paths[0]
        if not whole:
            raise ValueError(
                f"Expected MODEL/{' or MODEL/'.join(LAYOUTS.values())} in {place}, but "
                "there is none; give the folder of ShapeNet version 1 or 2."
            )
        return models

    def identify_model(self, name: str, path: Path) -> tuple[int, str]:
        """See `Source.identify_model`; reading the contents would take hours."""
        sizes = files.list_sizes([path, path.with_suffix(".mtl")])
        text = f"{path.parent.parent.name}/{path.parent.name} {sizes}"
        return self.spec.views, files.digest_text(text)

    def find_turn(self, path: str) -> np.ndarray:
        return TURNS[2 if Path(path).as_posix().endswith(LAYOUTS[2]) else 1]


def find_synset(folder: str | Path, category: str) -> Path:
    """The folder of a category or synset in the tree of synsets, or given itself."""
    synset = SYNSETS.get(category, category)
    if not re.fullmatch(r"\d{8}", synset):
        raise ValueError(
            f"category must be one of {', '.join(SYNSETS)} or a synset of eight "
            f"digits, but it is {category!r}; set config.category."
        )
    folder = Path(folder)
    for place in (folder / synset, folder):
        if place.name == synset and place.is_dir():
            return place
    raise ValueError(
        f"Expected the folder {synset} ({category}) in {folder}, but it is not there; "
        "give the folder that ShapeNet's synsets are unpacked in."
    )


def list_synsets(folder: Path) -> list[str]:
    """Names of the synsets that a folder is or holds, sorted; of dates none is one."""
    folder = folder.resolve()
    names = [folder.name, *(p.name for p in folder.iterdir() if p.is_dir())]
    return sorted(name for name in names if re.fullmatch(r"0\d{7}", name))
