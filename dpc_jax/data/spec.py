"""The specification of a data set: everything that determines its bytes."""

import dataclasses

from dpc_jax.config import CROPS, Data, Render
from dpc_jax.data.splits import SPLITS

KINDS = {  # of folders, and the class that reads each, in `dpc_jax.data.sets`
    # A folder of an unknown kind is the first that recognizes it.
    "shapenet": "shapenet.ShapeNet",
    "renders": "released_renders.ReleasedRenders",
    "meshes": "mesh_folder.MeshFolder",
    "images": "image_folder.ImageFolder",
}
SEEDS_PER_SPLIT = 1_000_000
FEW = 300  # models of a folder, below which copies and procedural shapes are added


@dataclasses.dataclass(frozen=True)
class DataSpec:
    """Everything that determines a data set; equal specs give equal bytes.

    With `folder` the models are what is in it, split by `fractions` and `seed` or by an
    official split file; `kind` says what that is: mesh files, a ShapeNet tree, renders
    as published with the paper's code, or a user's own images. Without a folder they
    are procedural shapes of `category`, and each split has its own seeds.
    """

    category: str  # "car", "chair", "airplane"; with a folder only a label
    folder: str | None = None  # None for procedural shapes
    split: str = "train"  # "train", "val" or "test"
    fractions: tuple = (0.8, 0.1, 0.1)  # of a folder's files; (0, 0, 1): all to test
    models: int | None = None  # how many; None: all files of the folder's split
    fold: tuple | None = None  # (i, n): of n parts of the files the i-th is tested
    copies: int = 1  # per file, stretched but for the first; 0: up to `FEW` in all
    mix: int = 0  # procedural shapes beside the files; -1: `FEW` if these are fewer
    seed: int = Data.seed  # of the split, the shapes, the views and the lights
    views: int = Data.views  # per model (paper, section Experiments)
    elevation: tuple = (-20.0, 40.0)  # degrees, uniform; azimuth is uniform in 360
    image_size: int = Data.image_size  # pixels
    focal_length: float = Render.focal_length
    distance: float = Render.distance  # camera to object, in box diagonals
    offset: float = Data.offset  # of the object from the axis of view, see `Data`
    focal_spread: float = Data.focal_spread  # share that a view's focal length varies
    corner_views: bool = False  # also from the corners of a cube (EPCG)
    extent: float = 1.0  # of the image plane
    supersample: int = 4  # rays per pixel along each axis
    surface_points: int = Data.surface_points  # ground truth per model, before thinning
    surface_voxel: float = Data.surface_voxel  # one point per voxel this wide; 0: all
    surface_seen: bool = False  # also which points can be seen from outside
    kind: str = "meshes"  # of the folder, one of `KINDS`
    split_file: str | None = None  # official split; None: looked for in the folder
    ground_truth: str | None = None  # folder of the published ground truth
    crop: str = Data.crop  # of own images: one scale per "object", "view", or "none"
    fill: float = Data.fill  # share of the frame that an own image's object takes

    def __post_init__(self):
        allowed = {"split": SPLITS, "kind": KINDS, "crop": CROPS}
        for name, known in allowed.items():
            if getattr(self, name) not in known:
                raise ValueError(
                    f"{name} must be one of {', '.join(map(repr, known))}, but it is "
                    f"{getattr(self, name)!r}; choose one of them."
                )
        if self.kind != type(self).kind and self.folder is None:
            raise ValueError(
                f"folder must name one for kind {self.kind!r}, but it is None; give it."
            )
        if self.folder is None and self.models is None:
            raise ValueError(
                "models must be a number for procedural shapes, which have no end, but "
                "it is None; set models or give a folder."
            )
        self._check_ranges()

    def _check_ranges(self):
        low, high = self.elevation
        index, count = self.fold or (0, 2)
        models = 1 if self.models is None else self.models  # None stands for all
        ranges = {
            "views": (self.views >= 1, "at least 1"),
            "image_size": (self.image_size >= 1, "at least 1"),
            "supersample": (self.supersample >= 1, "at least 1"),
            "surface_points": (self.surface_points >= 1, "at least 1"),
            "fold": (0 <= index < count > 1, "(i, n) with 0 <= i < n and n above 1"),
            "copies": (self.copies >= 0, "at least 0"),
            "mix": (self.mix >= -1, "at least -1"),
            "seed": (self.seed >= 0, "at least 0"),
            "fill": (0.1 <= self.fill <= 1, "in [0.1, 1]"),
            "surface_voxel": (0 <= self.surface_voxel < 1, "in [0, 1)"),
            "focal_length": (self.focal_length > 0, "above 0"),
            "offset": (0 <= self.offset < 0.5, "in [0, 0.5)"),
            "focal_spread": (0 <= self.focal_spread < 1, "in [0, 1)"),
            "extent": (self.extent > 0, "above 0"),
            # the object reaches 0.5 from its centre
            "distance": (self.distance > 0.5, "above 0.5, outside of the object"),
            "elevation": (
                -90 < low <= high < 90,
                "(low, high) with -90 < low <= high < 90 degrees",
            ),
            "models": (1 <= models <= SEEDS_PER_SPLIT, f"in [1, {SEEDS_PER_SPLIT}]"),
        }
        for name, (is_right, expected) in ranges.items():
            if not is_right:
                raise ValueError(
                    f"{name} must be {expected}, but it is {getattr(self, name)}; "
                    "change it."
                )
