"""The experiments of the paper: a table or figure each, and the rows that are trained.

A row names a config by its variant and what differs from that. Rows of several
experiments that come to the same config are the same run. Another method is another
row.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

from dpc_jax.experiments import published
from dpc_jax.experiments.published import CATEGORIES, PublishedTable


@dataclasses.dataclass(frozen=True)
class Row:
    """A line of a table."""

    label: str  # in our table
    published: str = ""  # name of the paper's row in the experiment's table
    # The text after the colon of --config, "paper" before it; None for the mean shape
    # of the training set, which the others measure beside theirs.
    variant: str | None = ""
    # "section.field": value, beside the variant
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    tag: str = ""  # names the changes in the folder of the run
    budget: str = ""  # of the size; "" for that of the resolution
    is_long: bool = False  # whether a run takes over ten minutes at the size "cpu"


@dataclasses.dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper."""

    name: str  # of --experiment
    title: str  # of its section of the page
    question: str
    table: PublishedTable  # the paper's numbers
    metrics: tuple[str, ...]  # names of `metrics.json` that its table shows
    rows: tuple[Row, ...]  # what is trained
    categories: tuple[str, ...] = CATEGORIES  # that it can be made of


# What several rows change beside their variant.
CONTAINED = {"train.containment_weight": 30.0}
BESIDE = {"train.colors_move_points": False}
SHIPPED = "shipped"  # budget of rows that are configs as they are, not the paper's

KINDS = {"": "hand-tuned σ", "sigma": "learned σ", "covariance": "learned covariance"}
# Hand-tuned sigma at the end of a run, a share of the volume's side, by number of
# points: the best on validation views of those tried.
_HAND_TUNED = {20: 0.055, 60: 0.035, 200: 0.03, 2000: 0.02}


def _change_point_sizes(kind: str, count: int) -> dict[str, Any]:
    """Fields of the config for points of one kind of `KINDS`.

    All kinds learn the peak height of Eq. 3 and drop no points.
    """
    changes = {
        "render.num_points": count,
        "render.scale_unit": "peak",
        "render.keep_start": 1.0,
        "render.keep_levels": 1,
        "network.point_size": kind,
    }
    if not kind:
        end = _HAND_TUNED[count]
        changes |= {"render.sigma_start": max(0.05, end), "render.sigma_end": end}
    return changes


def _list_point_sizes(*counts: int) -> tuple[Row, ...]:
    return tuple(
        Row(
            f"{label}, {count} points",
            variant="known_pose,32",
            changes=_change_point_sizes(kind, count),
            tag=f"{kind or 'fixed'}{count}",
            budget="points",
        )
        for kind, label in KINDS.items()
        for count in counts
    )


def _count_points(count: int) -> Row:
    changes = {"render.num_points": count}
    tag = f"{count}-points"
    return Row(f"{count} points", f"{count} pts.", "known_pose,64", changes, tag)


_MEAN_SHAPE = Row("Mean shape of the training set", variant=None)
_DEFAULTS = Row("Defaults of this package", budget=SHIPPED)
_SILHOUETTES = Row("Known pose, silhouettes", variant="known_pose,32")
_POSES = ("pose_accuracy", "pose_median_error_deg")
_PARTS = ("chamfer", "precision", "coverage")
_PIXELS = ("projection_error", "silhouette_iou", "chamfer")

# fmt: off
EXPERIMENTS = (
    Experiment(
        "known_pose",
        "Shape with known pose",
        "How near do shapes come when poses are given, and does a finer image help?",
        published.KNOWN_POSE,
        _PARTS,
        (
            _MEAN_SHAPE,
            Row("DRC, 32²", "DRC, 32", "known_pose,32,drc"),
            Row("PTN, 32²", "PTN, 32", "known_pose,32,ptn"),
            Row("Ours-V, 32²", "Ours-V, 32", "known_pose,32,ours_v"),
            Row("Ours, 32²", "Ours, 32", "known_pose,32"),
            Row("Ours-V, 64²", "Ours-V, 64", "known_pose,64,ours_v", is_long=True),
            Row("Ours, 64²", "Ours, 64", "known_pose,64"),
            Row("EPCG, 32²", variant="known_pose,32,epcg"),
            Row("EPCG, 128²", "EPCG, 128", "known_pose,128,epcg"),
            Row("Ours, 128²", "Ours, 128", "known_pose,128"),
        ),
    ),
    Experiment(
        "unknown_pose",
        "Shape and pose from silhouettes alone",
        "Does the ensemble find the poses that one regressor cannot?",
        published.UNKNOWN_POSE,
        ("chamfer", *_POSES),
        (
            _MEAN_SHAPE,
            Row("GT pose", "GT pose", "gt_pose"),
            Row("MVC", "MVC", "mvc"),
            Row("Ours-V", variant="ours_v"),
            Row("Ours-naive", "Ours-naive", "naive"),
            Row("Ours", "Ours"),
            Row("Defaults of this package, single regressor", variant="naive",
                budget=SHIPPED),
            _DEFAULTS,
        ),
    ),
    Experiment(
        "ablation",
        "Ablation",
        "What does each part of the method bring to the shape?",
        published.ABLATION,
        _PARTS,
        (
            Row("Full, 8000 points", "Full", "known_pose,64"),
            Row("No dropout", "No drop.", "known_pose,64", {"render.keep_start": 1.0},
                "no-dropout"),
            # 1.6 voxels of 64³
            Row("Fixed σ", "Fixed σ", "known_pose,64",
                {"render.sigma_start": 0.025, "render.sigma_end": 0.025},
                "fixed-sigma"),
            # A voxel's mass, because the paper gives none
            Row("Fixed scale", "Fixed scale", "known_pose,64",
                {"render.scale_fixed": 1.0}, "fixed-scale"),
            *map(_count_points, (4000, 2000, 1000)),
        ),
        categories=("chair",),
    ),
    Experiment(
        "points",
        "Error against number of points",
        "How many points does a shape need when their sizes are learned, and what do "
        "learned covariances look like?",
        published.POINTS,
        _PIXELS,
        _list_point_sizes(20, 60, 200, 2000),
        categories=("chair",),
    ),
    Experiment(
        "color",
        "Supervision by colour",
        "Does colour tell the front from the back, and what does it cost the shape?",
        published.SUPERVISION,
        ("chamfer", *_POSES, "flip_share", "color_psnr"),
        (
            Row("Silhouettes", budget="signals"),
            Row("With colour", variant="color", budget="signals"),
            _DEFAULTS,
            Row("Defaults of this package, with colour", variant="color",
                budget=SHIPPED),
            _SILHOUETTES,
            Row("Known pose, with colour", variant="known_pose,32,color"),
            Row("Known pose, with colour that moves no points",
                variant="known_pose,32,color", changes=BESIDE, tag="beside"),
        ),
        categories=("car", "chair"),
    ),
    Experiment(
        "depth",
        "Supervision by depth",
        "How much do depth maps bring over silhouettes?",
        published.SUPERVISION,
        ("chamfer", "visible_chamfer", *_POSES, "depth_error_percent"),
        (
            _SILHOUETTES,
            Row("Known pose, contained, silhouettes", variant="known_pose,32",
                changes=CONTAINED, tag="contained"),
            Row("Known pose, contained, with depth", variant="known_pose,32,depth",
                changes=CONTAINED, tag="contained"),
            Row("Known pose, contained, depth alone", variant="known_pose,32,depth",
                changes=CONTAINED | {"train.silhouette_weight": 0.0},
                tag="contained-alone"),
            _DEFAULTS,
            Row("Defaults of this package, with depth", variant="depth",
                budget=SHIPPED),
        ),
        categories=("car", "chair"),
    ),
    Experiment(
        "correspondences",
        "Semantic correspondences",
        "Do points of the same index lie on the same part of every chair?",
        published.CORRESPONDENCES,
        (),
        (_DEFAULTS,),
        categories=("chair",),
    ),
    Experiment(
        "interpolation",
        "Interpolation between shapes",
        "Does the way from one chair to another lead over chairs?",
        published.INTERPOLATION,
        (),
        (_DEFAULTS,),
        categories=("chair",),
    ),
)
# fmt: on
NAMES = tuple(experiment.name for experiment in EXPERIMENTS)
