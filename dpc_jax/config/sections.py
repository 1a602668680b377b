"""Every setting of a run: its default, its unit and the values that are allowed.

The defaults are those of the quick default runs. `dpc_jax.config.variants` has the
paper's values. A field has one name everywhere: `--config.pose.num_heads=8` on the
command line, `config.pose.num_heads` in Python. Functions take the sections that they
need.
"""

import dataclasses

from dpc_jax.config.fields import (
    FOLD,
    FOLDER,
    Allowed,
    above,
    at_least,
    between,
    field,
    one_of,
)

CROPS = ("object", "view", "none")  # images that are scaled alike
FILL = 0.85  # share of the frame that images cut out so fill
# Of the cameras of rendered views, degrees, uniform (§ Datasets); azimuths: all 360.
ELEVATIONS = (-20.0, 40.0)
_IMAGE_SIZE = Allowed(
    lambda size: size >= 16 and size & (size - 1) == 0,
    "a power of two of at least 16 pixels, because the encoder halves it down to 4",
)
# A cloud that needs more blocks than there are is drawn in the whole volume up to here.
_GRID = between(1, 256)
_MODELS = between(1, 1_000_000)  # no two splits or seeds share a procedural shape
_DISTANCE = above(0.5)._replace(text="above 0.5, outside the object")
_HEADS = at_least(1)._replace(text="at least 1 (K heads)")


@dataclasses.dataclass(frozen=True)
class Data:
    """Which objects, and how they are seen."""

    meshes: str = field("", FOLDER)  # of mesh files, z up, x front; "": procedural
    shapenet: str = field("", FOLDER)  # of ShapeNet's synsets, version 1 or 2, or ""
    renders: str = field("", FOLDER)  # of the renders published with the paper, or ""
    images: str = field("", FOLDER)  # of your images, a folder of views per object
    test_meshes: str = field("", FOLDER)  # to test on; "": a part of the same source
    fold: str = field("", FOLD)  # "0/5": of five parts the first is tested; "": a tenth
    # What has a scale of its own: an object, each view, or nothing ("none").
    crop: str = field("object", one_of(*CROPS))
    models: int = field(1000, _MODELS)  # procedural models to train on
    val_models: int = field(20, _MODELS)  # to validate on; the first 20 align
    test_models: int = field(100, _MODELS)  # to test on
    # Of each mesh, stretched; 0: as many as make 300 models, and 300 procedural ones
    # are added to fewer meshes.
    copies: int = field(0, at_least(0))
    views: int = field(5, at_least(1))  # per model (§ Datasets)
    # Largest shift of an object along each axis, box diagonals.
    offset: float = field(0.0, between(0, 0.12))
    # Largest change of a view's focal length, as a share of it.
    focal_spread: float = field(0.0, between(0, 0.25))
    image_size: int = field(64, _IMAGE_SIZE)  # pixels
    surface_points: int = field(10_000, at_least(1))  # ground truth, before thinning
    # Side of the cells that keep one point of the ground truth each; 0: all are kept.
    surface_voxel: float = field(0.0, between(0, 0.99))
    seed: int = field(0, at_least(0))  # of shapes, split, views and lights
    cache_dir: str = "data"  # folder where rendered sets are kept


@dataclasses.dataclass(frozen=True)
class Network:
    """Widths of the layers, in units."""

    channels: int = field(16, at_least(1))  # of the first convolution (released code)
    hidden: int = field(512, at_least(1))  # of encoder and pose branches
    shape_hidden: int = field(512, at_least(1))  # of the shape branch's hidden layer
    # The paper's, or its code's; "": normalised, and a wider student.
    layers: str = field("", one_of("", "paper", "released"))
    # What is learned of the size of each point; "": nothing.
    point_size: str = field("", one_of("", "sigma", "covariance"))
    # What is predicted; voxels and maps have the side `render.grid`.
    shape: str = field("points", one_of("points", "voxels", "maps"))
    sees_mask: bool = True  # beside the image, as a fourth channel


@dataclasses.dataclass(frozen=True)
class Render:
    """Volume, points and camera of the projection."""

    grid: int = field(32, _GRID)  # side of volume and target silhouettes, voxels
    # Of winners after 60 % of steps; 0: never.
    fine_grid: int = field(64, between(0, 256))
    num_points: int = field(2000, at_least(1))  # of a cloud (2000 at 32³ in the paper)
    sigma_start: float = field(0.05, between(0, 1))  # of the volume's side (§ Training)
    sigma_end: float = field(0.003, between(0, 1))  # of the volume's side
    anneal_until: float = field(0.8, above(0, 1))  # share of the run
    # Share of points kept (§ Training): until the fine grid begins, and from then on;
    # without one, at the start and the end of the schedule.
    keep_start: float = field(1.0, above(0, 1))
    keep_end: float = field(1.0, above(0, 1))
    # What a ray makes of its occupancies: Eq. 5, or their maximum, as PTN.
    ray_rule: str = field("termination", one_of("termination", "maximum"))
    scale_unit: str = field("mass", one_of("peak", "mass"))  # of the learned scale
    scale_fixed: float = field(0.0, at_least(0))  # in that unit; 0: learned
    focal_length: float = field(1.875, above(0))  # of an image 1 wide
    distance: float = field(2.0, _DISTANCE)  # camera to object, box diagonals
    # Views rendered side by side; 0: one on a CPU, all on a GPU.
    renders_at_once: int = field(0, at_least(0))

    @property
    def finest(self) -> int:
        """Side of the finest grid that a run renders in."""
        return self.fine_grid or self.grid


@dataclasses.dataclass(frozen=True)
class Pose:
    """The pose candidates, and the student that learns from their winners."""

    # Where poses come from: the ensemble in hindsight; the data, none to learn (the
    # variant known_pose); the data, and a regressor learns them (gt_pose); drawn heads
    # (mvc).
    source: str = field("unknown", one_of("unknown", "given", "labels", "sampled"))
    num_heads: int = field(8, _HEADS)  # K heads (§ distilled ensemble)
    # Of an upright camera, or any rotation.
    head: str = field("viewpoint", one_of("quaternion", "viewpoint"))
    # Range of elevations that viewpoint heads predict, degrees.
    elevation_low: float = field(ELEVATIONS[0], between(-90, 90))
    elevation_high: float = field(ELEVATIONS[1], between(-90, 90))
    flips: bool = True  # also try each head after half turns of the object
    # Regresses a pose, by the paper's angle (q and -q alike) or by the released code's
    # squares of it; or tells which candidate is how likely.
    student: str = field("selects", one_of("regresses", "squares", "selects"))
    # Candidates compared exactly, the best of a ranking by few points, half as many in
    # the fine grid; 0, and of points with sizes of their own: all.
    choice_top: int = field(6, at_least(0))
    # What tells half turns apart, to turn back what is reversed: of objects, where
    # their points are; of views, where they have which colours; "": nothing is.
    common_frame: str = field("points", one_of("", "points", "colors"))
    student_weight: float = field(0.003, at_least(0))  # per pixel of the silhouette
    translation: bool = False  # of each view, learned (released code)
    focal_length: bool = False  # of each view, learned (released code)

    @property
    def known(self) -> bool:
        """Whether poses are read from the data, and none are learned."""
        return self.source == "given"

    @property
    def aligned(self) -> bool:
        """Whether shapes are learned with the poses of the data, in its own frame."""
        return self.source in ("given", "labels")

    @property
    def selects(self) -> bool:
        """Whether the student chooses a candidate instead of regressing a pose."""
        return self.student == "selects"

    @property
    def learned_heads(self) -> int:
        """K heads that are learned: none where poses are known.

        One where labels are learned without a student that selects.
        """
        if self.known:
            return 0
        return 1 if self.source == "labels" and not self.selects else self.num_heads

    @property
    def half_turns(self) -> bool:
        """Whether half turns of the heads are candidates too: of an ensemble only."""
        return self.flips and self.learned_heads > 1 and self.source == "unknown"

    @property
    def elevations(self) -> tuple[float, float] | None:
        """Range of the cameras' elevations, degrees, that viewpoint heads are told."""
        if self.head != "viewpoint":
            return None
        return self.elevation_low, self.elevation_high

    @property
    def turns(self) -> int:
        """Turns of the object that each head is tried after, none among them.

        Upright viewpoints leave a half turn about the vertical.
        """
        if not self.half_turns:
            return 1
        return 2 if self.elevations else 4

    @property
    def weighs_fit(self) -> bool:
        """Whether predictions weigh how candidates fit the image's silhouette.

        Of drawn heads (MVC) the likeliest is taken.
        """
        return self.choices > 0 and self.source != "sampled"

    @property
    def choices(self) -> int:
        """How many candidates a selecting student chooses among; 0: it regresses."""
        if not self.selects or self.learned_heads < 2:
            return 0
        return self.learned_heads * self.turns


@dataclasses.dataclass(frozen=True)
class Train:
    """Steps, batches, the optimiser and the weights of the losses."""

    steps: int = field(4200, at_least(1))  # in all; the schedules end there
    init_from: str = ""  # workdir of the run whose parameters are the first
    models_per_batch: int = field(4, at_least(1))  # (§ Training details)
    views_per_batch: int = field(4, at_least(1))  # of each model
    learning_rate: float = field(3e-4, above(0))  # at its peak
    # Muon for convolutions, Adam for all else, with a warm-up and a cosine decay; or
    # Adam at a constant rate, as the paper.
    optimizer: str = field("muon", one_of("muon", "adam"))
    l2_weight: float = field(0.0, at_least(0))  # half squared weights (released code)
    # The network sees half of the views cut out by their masks, as photographs are.
    framed_views: bool = True
    # Renders of points are compared with masks as wide as points would draw them.
    spread_masks: bool = True
    pull_weight: float = field(0.03, at_least(0))  # of points outside, per pixel
    # Of the mean energy by which points repel each other, late in the run.
    repulsion_weight: float = field(0.0, at_least(0))
    containment_weight: float = field(30.0, at_least(0))  # of points beyond radius 1/2
    silhouette_weight: float = field(1.0, at_least(0))  # per pixel; 0: not compared
    # Cost of a ray that ends in the background (DRC); 0: squared differences.
    background_weight: float = field(0.0, between(0, 1))
    # Per pixel, of depths in box diagonals; 0: none are compared.
    depth_weight: float = field(0.0, at_least(0))
    color_weight: float = field(0.0, at_least(0))  # per pixel; 0: no colours
    # Their loss has a gradient for the shape; else they see the image's mean colour.
    colors_move_points: bool = False


@dataclasses.dataclass(frozen=True)
class Log:
    """Steps between records, 0 is never; and the tools that show them."""

    every: int = field(100, at_least(1))  # steps between lines of metrics.jsonl
    evaluate: int = field(1000, at_least(0))  # steps between validations
    checkpoint: int = field(1000, at_least(0))  # steps between checkpoints
    tensorboard: bool = False  # event files too, in WORKDIR/tensorboard


@dataclasses.dataclass(frozen=True)
class Machine:
    """What of the machine a run uses; results agree to rounding."""

    devices: int = field(0, at_least(0))  # that share a batch's objects; 0: all


@dataclasses.dataclass(frozen=True)
class Config:
    """A run: what it learns from, what it learns, and how."""

    category: str  # "car", "chair" or "airplane" of procedural shapes; else a label
    variant: str = ""  # the text after the colon of --config
    seed: int = field(0, at_least(0))  # of everything random but the data
    data: Data = Data()
    network: Network = Network()
    render: Render = Render()
    pose: Pose = Pose()
    train: Train = Train()
    log: Log = Log()
    run: Machine = Machine()

    @property
    def spreads_masks(self) -> bool:
        """Whether masks are spread: for renders of points alone."""
        return self.train.spread_masks and self.network.shape == "points"
