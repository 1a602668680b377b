"""The specification of a data set: everything that determines its bytes."""

import dataclasses

from dpc_jax.config import FILL, Data, Render

KINDS = {  # of folders, and the class that reads each, in `dpc_jax.data.sets`
    "shapenet": "shapenet.ShapeNet",
    "renders": "released_renders.ReleasedRenders",
    "meshes": "mesh_folder.MeshFolder",
    "images": "image_folder.ImageFolder",
}
SEEDS_PER_SPLIT = 1_000_000
SUPERSAMPLE = 4  # rays per pixel along each axis: masks have 17 levels
FEW = 300  # models of a folder, below which copies and procedural shapes are added


@dataclasses.dataclass(frozen=True)
class DataSpec:
    """Everything that determines a data set; equal specs give equal bytes.

    With `folder` the models are what is in it, split by `fractions` and `seed` or by an
    official split in it; `kind` says what that is: mesh files, a ShapeNet tree, renders
    as published with the paper's code, or a user's own images. Without a folder they
    are procedural shapes of `category`, and each split has its own seeds, "final" too.
    """

    category: str  # "car", "chair", "airplane"; with a folder only a label
    folder: str | None = None  # None for procedural shapes
    split: str = "train"  # "train", "val", "test"; "final" of procedural shapes
    fractions: tuple = (0.8, 0.1, 0.1)  # of a folder's files; (0, 0, 1): all to test
    models: int | None = None  # how many; None: all files of the folder's split
    fold: tuple | None = None  # (i, n): of n parts of the files the i-th is tested
    copies: int = 1  # per file, stretched but for the first; 0: up to `FEW` in all
    mix: bool = False  # `FEW` procedural shapes beside the files, if these are fewer
    seed: int = Data.seed  # of the split, the shapes, the views and the lights
    views: int = Data.views  # per model (paper, section Experiments)
    image_size: int = Data.image_size  # pixels
    focal_length: float = Render.focal_length
    distance: float = Render.distance  # camera to object, in box diagonals
    offset: float = Data.offset  # of the object from the axis of view, see `Data`
    focal_spread: float = Data.focal_spread  # share that a view's focal length varies
    corner_views: bool = False  # also from the corners of a cube (EPCG)
    surface_points: int = Data.surface_points  # ground truth per model, before thinning
    surface_voxel: float = Data.surface_voxel  # one point per voxel this wide; 0: all
    visible_points: int = 0  # also so many that can be seen from outside
    kind: str = "meshes"  # of the folder, one of `KINDS`
    crop: str = Data.crop  # of own images: one scale per "object", "view", or "none"
    fill: float = FILL  # share of the frame that an own image's object takes
