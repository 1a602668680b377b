"""The fields of every config, their default values, and the variants."""

import ml_collections

VARIANTS = ("", "paper", "naive", "known_pose")


def default_config(category: str) -> ml_collections.ConfigDict:
    """The fields of every config, with the values of the quick default runs."""
    c = ml_collections.ConfigDict()
    c.category = category  # "car", "chair", "airplane": what the procedural shapes are
    c.variant = ""  # the text after the colon of --config
    c.seed = 0  # of everything random but the data

    c.data = d = ml_collections.ConfigDict()
    d.meshes = ""  # folder of mesh files, z up, x front; "" for procedural shapes
    d.shapenet = ""  # folder of ShapeNet's synsets, version 1 or 2, or ""
    d.renders = ""  # folder of the renders published with the paper's code, or ""
    d.images = ""  # folder of your own images, one folder of views per object, or ""
    d.test_meshes = ""  # folder to test on; "" for a part of the same source
    d.own_test = 0.0  # with test_meshes, share of the source to be tested on apart
    d.split_file = ""  # official split of ShapeNet; "": looked for in the folder
    d.shapenet_front = ""  # axis its models face, "-z" for instance; "": its version's
    d.ground_truth = ""  # folder of MODEL.mat for the renders; "": looked for
    d.crop = "object"  # of own images: one scale per "object", per "view", or "none"
    d.fill = 0.85  # share of the frame that the object of an own image takes
    d.models = 1000  # procedural models to train on
    d.val_models = 40  # procedural models to validate on (20 of them align)
    d.test_models = 100  # procedural models to test on
    d.copies = 1  # of each mesh file; those beyond the first are stretched
    d.stretch = 0.15  # largest stretch of a copy along an axis, as a share
    d.views = 5  # per model (§ Datasets)
    d.image_size = 64  # pixels; a power of two
    d.surface_points = 10_000  # ground truth per model, before thinning
    d.surface_voxel = 0.0  # side of the voxels that keep one point each; 0: all stay
    d.surface_visible = False  # ground truth that can be seen from outside only
    d.seed = 0  # of shapes, split, views and lights
    d.cache_dir = "data"  # where rendered sets are kept
    d.processes = 0  # that render; 0 for one per core

    c.network = n = ml_collections.ConfigDict()
    n.channels = 16  # of the first convolution (released code)
    n.hidden = 512  # units of the encoder's and pose branches' dense layers
    n.shape_hidden = 512  # units of the shape branch's hidden layer
    n.student_width = 256  # units of the student's own layers (the paper's heads: 32)
    n.normalize = True  # features of a sample after each encoder layer

    c.render = r = ml_collections.ConfigDict()
    r.grid = 32  # side of the volume and of the silhouettes compared, voxels
    r.fine_grid = 64  # side for the winners' renders towards the end; 0 for none
    r.fine_from = 0.6  # share of the run from which that grid is used
    r.num_points = 2000  # of a predicted cloud (§ Training details: 2000 at 32)
    r.sigma_start = 0.05  # of the volume's side (§ Training details)
    r.sigma_end = 0.003
    r.anneal_until = 0.8  # share of the run at which both schedules end
    r.keep_start = 0.1  # share of points not dropped (§ Training details)
    r.keep_end = 1.0
    r.keep_levels = 4  # stairs of that schedule; each is compiled once
    r.scale_unit = "mass"  # learned scale: "peak" density or "mass" in voxels
    r.focal_length = 1.875  # of an image 1 wide
    r.distance = 2.0  # from camera to object, in box diagonals
    r.renders_at_once = 1  # views rendered side by side; 0 for all (GPU)

    c.pose = p = ml_collections.ConfigDict()
    p.known = False  # read the poses from the data instead of learning them
    p.candidates = 8  # K heads of the ensemble (§ distilled ensemble)
    p.spread = "all"  # where heads start: "all" of SO(3), "upright" cameras, or ""
    p.flips = True  # also try each head turned by 180° about the principal axes
    p.selects = True  # the student selects a candidate; False: regresses a pose
    p.choice_grid = 16  # volume that candidates are first compared in; 0: render.grid
    p.choice_points = 500  # points that they are first compared with; 0: all
    p.choice_top = 4  # of them are then compared exactly
    p.student_weight = 0.003  # of the student's loss, per pixel of the silhouette

    c.train = t = ml_collections.ConfigDict()
    t.steps = 6300
    t.models_per_batch = 4  # (§ Training details)
    t.views_per_batch = 4  # of each model
    t.learning_rate = 3e-4  # of Adam, at its peak
    t.warmup_steps = 200  # linear
    t.final_rate = 0.02  # share of the peak that the cosine decay ends at
    t.weight_decay = 0.0  # decoupled
    t.repulsion_weight = 0.0  # of the points' repulsion, at its end; 0 for none
    t.repulsion_points = 500  # of a cloud, that repel each other in a step
    t.containment_weight = 1.0  # of points beyond radius 1/2; 0 for none
    t.color_weight = 0.0  # of the colour loss per pixel; 0 learns no colour

    c.log = ml_collections.ConfigDict()
    c.log.every = 100  # steps between lines of metrics.jsonl
    c.log.evaluate = 1000  # steps between validations
    c.log.checkpoint = 1000  # steps between checkpoints
    return c


def apply_variant(config: ml_collections.ConfigDict, variant: str | None):
    """Turn a config into a variant of it: "paper", "naive" or "known_pose".

    Raises:
      ValueError: for another name.
    """
    variant = variant or ""
    if variant not in VARIANTS:
        raise ValueError(
            f"The variant after the colon of --config must be one of "
            f"{', '.join(VARIANTS[1:])}, but it is {variant!r}."
        )
    config.variant = variant
    if variant == "naive":
        config.pose.update(candidates=1, spread="", flips=False)
    if variant == "known_pose":
        config.pose.known = True
    if variant == "paper":
        # § Training details and § Network architecture, at 64 pixels.
        config.data.update(
            models=5247,
            val_models=750,
            test_models=1500,
            surface_points=100_000,  # § Evaluation, as in the released code
            surface_voxel=0.01,
        )
        config.network.update(
            hidden=1024, shape_hidden=1024, student_width=32, normalize=False
        )
        config.render.update(
            grid=64, fine_grid=0, num_points=8000, anneal_until=1.0, keep_levels=32
        )
        config.pose.update(
            candidates=4,
            student_weight=0.01,
            spread="",
            flips=False,
            selects=False,
            choice_grid=0,
            choice_points=0,
        )
        config.train.update(
            steps=600_000,
            learning_rate=1e-4,
            warmup_steps=0,
            final_rate=1.0,
            repulsion_weight=0.0,
            containment_weight=0.0,
        )
        config.log.update(every=500, evaluate=20_000, checkpoint=5000)
    return config
