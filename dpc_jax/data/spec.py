"""What a data set is made of: its specification, its models, its seeded splits."""

import dataclasses
import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dpc_jax.data import families

SPLITS = ("train", "val", "test")
KINDS = ("meshes", "shapenet", "renders", "images")
CROPS = ("object", "view", "none")
FRONTS = ("", "+x", "-x", "+z", "-z")
SIDECARS = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".webp")
SEEDS_PER_SPLIT = 1_000_000


@dataclasses.dataclass(frozen=True)
class DataSpec:
    """Everything that determines a data set; equal specs give equal bytes.

    With `folder` the models are what is in it, split by `fractions` and `seed` or by
    an official split file; `kind` says what that is: mesh files, a ShapeNet tree,
    renders as published with the paper's code, or a user's own images. Without, they
    are procedural shapes of `category`, each split with its own seeds.
    """

    category: str  # "car", "chair", "airplane"; with a folder only a label
    folder: str | None = None  # mesh files in the canonical frame, or None
    split: str = "train"  # "train", "val" or "test"
    fractions: tuple = (0.8, 0.1, 0.1)  # of a folder's files; (0, 0, 1): all to test
    models: int | None = None  # how many; None: all files of the folder's split
    copies: int = 1  # per file; the first is the original, the others are stretched
    stretch: float = 0.15  # of the stretched copies
    seed: int = 0  # of the split, the shapes, the views and the lights
    views: int = 5  # per model (paper, section Experiments)
    elevation: tuple = (-20.0, 40.0)  # degrees, uniform; azimuth is uniform in 360
    image_size: int = 64  # pixels
    focal_length: float = 1.875
    distance: float = 2.0  # camera to object, in box diagonals
    extent: float = 1.0  # of the image plane
    supersample: int = 4  # rays per pixel along each axis
    surface_points: int = 10_000  # ground truth per model, before thinning
    surface_voxel: float = 0.0  # one point is kept per voxel of this side; 0 for all
    surface_visible: bool = False  # only points that can be seen from outside
    kind: str = "meshes"  # of the folder
    split_file: str | None = None  # official split; None: looked for in the folder
    shapenet_front: str = (
        ""  # axis that ShapeNet's models face; "": as its version says
    )
    ground_truth: str | None = None  # folder of the published ground truth
    crop: str = "object"  # of own images: one scale per "object", "view", or "none"
    fill: float = 0.85  # share of the frame that an own image's object takes

    def __post_init__(self):
        for name in ("views", "image_size", "supersample", "surface_points", "copies"):
            if not getattr(self, name) >= 1:
                raise ValueError(
                    f"{name} must be at least 1, got {getattr(self, name)}; raise it."
                )
        if self.split not in SPLITS:
            raise ValueError(
                f"split must be one of {', '.join(SPLITS)}, got {self.split!r}."
            )
        for name, known in (
            ("kind", KINDS),
            ("crop", CROPS),
            ("shapenet_front", FRONTS),
        ):
            if getattr(self, name) not in known:
                raise ValueError(
                    f"{name} must be one of {known}, got {getattr(self, name)!r}."
                )
        if self.kind != "meshes" and self.folder is None:
            raise ValueError(f"kind {self.kind!r} needs a folder, got None; give one.")
        if self.kind in ("renders", "images") and self.copies > 1:
            raise ValueError(
                f"copies must be 1 where there are no meshes to stretch, got "
                f"{self.copies}."
            )
        if not 0.1 <= self.fill <= 1 or not 0 <= self.surface_voxel < 1:
            raise ValueError(
                "fill must lie in [0.1, 1] and surface_voxel in [0, 1), got "
                f"{self.fill} and {self.surface_voxel}."
            )
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}.")
        if self.models is not None and not 1 <= self.models <= SEEDS_PER_SPLIT:
            raise ValueError(
                f"models must lie in [1, {SEEDS_PER_SPLIT}], got {self.models}."
            )
        if self.folder is None and self.models is None:
            raise ValueError(
                "procedural shapes have no end: expected a number of models, got None; "
                "set models or give a folder."
            )
        low, high = self.elevation
        if not -90 < low <= high < 90:
            raise ValueError(
                "elevation must be (low, high) with -90 < low <= high < 90 degrees, "
                f"got {self.elevation}."
            )
        if min(self.focal_length, self.extent) <= 0 or self.distance <= 0.5:
            raise ValueError(
                "expected focal_length and extent above 0 and distance above 0.5 (the "
                f"object reaches 0.5 from its centre), got {self.focal_length}, "
                f"{self.extent} and {self.distance}."
            )


class Source(NamedTuple):
    """Where one model comes from.

    name: unique in the data set. path: mesh file, or None for a procedural shape.
    seed: of the procedural shape. copy: 0 for the original, above for stretched copies.
    digest: sha256 of the file's content, or of what else tells it from others, or "".
    views: how many there are at most.
    """

    name: str
    path: str | None
    seed: int
    copy: int
    digest: str
    views: int = 0


def list_sources(spec):
    """All models of a data set, in order (`list[Source]`).

    Raises:
      ValueError: if the folder has no mesh files, or none for this split.
    """
    if spec.folder is None:
        first = (spec.seed * len(SPLITS) + SPLITS.index(spec.split)) * SEEDS_PER_SPLIT
        return [
            Source(
                f"{spec.category}-{first + i:07d}", None, first + i, 0, "", spec.views
            )
            for i in range(spec.models)
        ]
    if spec.kind != "meshes":
        from dpc_jax.data.sets import listings

        catalog = listings.open_catalog(spec, split_files=split_files)
        found = listings.describe_models(spec, catalog)
        sources = [
            Source(f"{name}#{copy}" if copy else name, path, 0, copy, key, views)
            for copy in range(spec.copies)
            for name, path, views, key in found
        ]
        return sources[: spec.models]
    from dpc_jax.data.meshes import find_meshes

    paths = find_meshes(spec.folder)
    digests = [_digest(path) for path in paths]
    groups = families.group_variants(paths, digests)
    sides = split_files(paths, fractions=spec.fractions, seed=spec.seed, groups=groups)
    chosen = sides[SPLITS.index(spec.split)]
    if not chosen:
        raise ValueError(
            f"expected mesh files for the {spec.split} split of {spec.folder}, got "
            f"none ({len(paths)} files split by {spec.fractions}); add files or "
            "change the fractions."
        )
    known = dict(zip(paths, digests, strict=True))
    sources = []
    for copy in range(spec.copies):
        for path in chosen:
            name = path.relative_to(spec.folder).as_posix()
            name = f"{name}#{copy}" if copy else name
            sources.append(Source(name, str(path), 0, copy, known[path], spec.views))
    return sources[: spec.models]


def split_files(paths, *, fractions, seed, groups=None):
    """Seeded split of files into (train, val, test), each sorted.

    Files of one group (equal content, say) stay on one side. Every side with a positive
    fraction gets at least one group, as far as there are enough.

    Args:
      paths: sequence of paths, distinct.
      fractions: three shares >= 0 with a positive sum; only their ratios count.
      seed: integer >= 0.
      groups: one hashable key per path; by default each path is its own group.

    Returns:
      Three lists of paths; together they hold every path once.

    Raises:
      ValueError: if the fractions are not three shares with a positive sum.
    """
    shares = np.asarray(fractions, dtype=np.float64)
    if shares.shape != (3,) or not (shares >= 0).all() or not shares.sum() > 0:
        raise ValueError(
            "fractions must be three shares (train, val, test), none negative and not "
            f"all zero, got {fractions}; use for instance (0.8, 0.1, 0.1)."
        )
    members = {}
    for path, key in sorted(zip(paths, groups or paths, strict=True)):
        members.setdefault(key, []).append(path)
    ordered = list(members.values())
    order = np.random.default_rng(seed).permutation(len(ordered))
    counts = np.floor(shares / shares.sum() * len(ordered) + 1e-9).astype(int)
    counts[np.argmax(shares)] += len(ordered) - counts.sum()
    for side in np.flatnonzero((shares > 0) & (counts == 0)):
        if counts.max() > 1:
            counts[np.argmax(counts)] -= 1
            counts[side] = 1
    stops = np.cumsum(counts)
    return tuple(
        sorted(path for i in order[stop - count : stop] for path in ordered[i])
        for stop, count in zip(stops, counts, strict=True)
    )


def list_sidecars(spec):
    """(relative path, sha256) of the materials and textures that a folder holds."""
    if spec.folder is None or spec.kind != "meshes":
        return []
    folder = Path(spec.folder)
    paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SIDECARS)
    return [
        (path.relative_to(folder).as_posix(), _digest(path))
        for path in paths
        if path.is_file()
    ]


def _digest(path):
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
