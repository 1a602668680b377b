"""The experiments of the paper, each a list of rows; a further method is a further row.

What a row and an experiment say is in `declarations`.
"""

from collections.abc import Sequence

from dpc_jax.experiments import published
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.point_kinds import list_changes
from dpc_jax.experiments.row_settings import DEFAULTS, FRAME, POSES, PULL
from dpc_jax.experiments.signals import SIGNAL_EXPERIMENTS

KINDS = {"": "hand-tuned σ", "sigma": "learned σ", "covariance": "learned covariance"}


def _learn_points(kind: str, count: int) -> Row:
    """A row of points of one kind; hand-tuned ones are rendered the same way."""
    return Row(
        f"{KINDS[kind]}, {count} points",
        variant="known_pose,32",
        changes=list_changes(kind, count),
        tag=f"{kind or 'fixed'}{count}",
        budget="points",
    )


def _list_points(counts: Sequence[int]) -> tuple[Row, ...]:
    return tuple(_learn_points(kind, count) for kind in KINDS for count in counts)


def _count_points(count: int) -> Row:
    return Row(
        f"{count} points",
        f"{count} pts.",
        "known_pose,64",
        {"render.num_points": count},
        f"{count}-points",
    )


MEAN_SHAPE = Row("Mean shape of the training set", measure="mean_shape:measure")
EXPERIMENTS = (
    Experiment(
        "known_pose",
        "Shape with known pose",
        "How near do shapes come when poses are given, and does a finer image help?",
        published.KNOWN_POSE,
        ("chamfer", "precision", "coverage"),
        (
            MEAN_SHAPE,
            Row("DRC, 32²", "DRC, 32", "known_pose,32,drc"),
            Row("PTN, 32²", "PTN, 32", "known_pose,32,ptn"),
            Row("Ours-V, 32²", "Ours-V, 32", "known_pose,32,ours_v"),
            Row("Ours, 32²", "Ours, 32", "known_pose,32"),
            Row("Ours, 32², with pull", "", "known_pose,32", PULL, "pull"),
            Row(
                "Ours, 32², minutes of Ours-V", variant="known_pose,32", budget="longer"
            ),
            Row("Ours-V, 64²", "Ours-V, 64", "known_pose,64,ours_v", is_long=True),
            Row("Ours, 64²", "Ours, 64", "known_pose,64"),
            Row("EPCG, 32²", variant="known_pose,32,epcg"),
            Row(
                "EPCG, 32², second stage from 5/6",
                variant="known_pose,32,epcg",
                changes={"render.fixed_views_until": 5 / 6},
                tag="two-stages",
            ),
            Row(
                "EPCG, 32², masks alone",
                variant="known_pose,32,epcg",
                changes={"train.depth_weight": 0.0},
                tag="masks",
            ),
            Row("EPCG, 128²", "EPCG, 128", "known_pose,128,epcg"),
            Row("Ours, 128²", "Ours, 128", "known_pose,128"),
        ),
    ),
    Experiment(
        "unknown_pose",
        "Shape and pose from silhouettes alone",
        "Does the ensemble find the poses that one regressor cannot?",
        published.UNKNOWN_POSE,
        ("chamfer", *POSES),
        (
            MEAN_SHAPE,
            Row("GT pose", "GT pose", "gt_pose"),
            Row("MVC", "MVC", "mvc", {"pose.head": "viewpoint"}),
            Row("Ours-V", variant="ours_v"),
            Row("Ours-naive", "Ours-naive", "naive"),
            Row("Ours", "Ours", ""),
            Row("Ours, one frame, pull and containment", "", "", FRAME, "frame"),
            Row("Ours, defaults of this package", "", "", DEFAULTS, "defaults"),
        ),
        picture="predictions.png",
    ),
    Experiment(
        "ablation",
        "Ablation",
        "What does each part of the method bring to the shape?",
        published.ABLATION,
        ("chamfer", "precision", "coverage"),
        (
            Row("Full, 8000 points", "Full", "known_pose,64"),
            Row(
                "No dropout",
                "No drop.",
                "known_pose,64",
                {"render.keep_start": 1.0},
                "no-dropout",
            ),
            Row(
                "Fixed σ",
                "Fixed σ",
                "known_pose,64",
                {"render.sigma_fixed": 0.025},  # 1.6 of 64 voxels
                "fixed-sigma",
            ),
            Row(
                "Fixed scale",
                "Fixed scale",
                "known_pose,64",
                {"render.scale_fixed": 1.0},  # a voxel's mass; the paper gives none
                "fixed-scale",
            ),
            *map(_count_points, (4000, 2000, 1000)),
        ),
        categories=("chair",),
    ),
    Experiment(
        "points",
        "Error against number of points",
        "How many points does a shape need when their sizes are learned?",
        published.POINTS,
        ("projection_error", "silhouette_iou", "chamfer"),
        _list_points((20, 60, 200, 2000)),
        categories=("chair",),
        analysis="point_sizes:draw",
        reads="all",
    ),
    Experiment(
        "covariance",
        "Shapes of twenty Gaussians",
        "What do learned covariances look like where there are few points?",
        published.POINTS,
        ("projection_error", "silhouette_iou", "chamfer"),
        _list_points((20,)),
        categories=("chair",),
        analysis="point_sizes:draw",
        reads="all",
    ),
    *SIGNAL_EXPERIMENTS,
    Experiment(
        "correspondences",
        "Semantic correspondences",
        "Do points of the same index lie on the same part of every chair?",
        published.CORRESPONDENCES,
        (),
        (Row("Ours", variant=""),),
        categories=("chair",),
        analysis="correspondences:run",
    ),
    Experiment(
        "interpolation",
        "Interpolation between shapes",
        "Does the way from one chair to another lead over chairs?",
        published.INTERPOLATION,
        (),
        (Row("Ours", variant=""),),
        categories=("chair",),
        analysis="interpolation:run",
    ),
)
NAMES = tuple(experiment.name for experiment in EXPERIMENTS)


def find_experiments(name: str) -> tuple[Experiment, ...]:
    """The experiments of --experiment: one, several with commas between, or "all".

    Raises:
      ValueError: for a name that is not known.
    """
    asked = [part.strip() for part in name.split(",")]
    if asked == ["all"]:
        return EXPERIMENTS
    if unknown := [part for part in asked if part not in NAMES]:
        raise ValueError(
            f"--experiment must be all, or of {', '.join(NAMES)}, but it has "
            f"{unknown[0] or 'an empty name'}; write for example "
            "--experiment=known_pose,ablation."
        )
    return tuple(e for e in EXPERIMENTS if e.name in asked)
