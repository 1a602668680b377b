"""How large the runs of each --size are, and why.

A value here replaces that of the config after its variant. Where a row says a value
itself, that one counts.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

# What the paper's method has not, and rows of their own are for.
_PLAIN = {
    "pose.head": "quaternion",
    "pose.predicted": "student",
    "pose.common_frame": False,
    "train.pull_weight": 0.0,
    "train.containment_weight": 1.0,
    "train.reseeds_points": False,
    "train.colors_move_points": True,
    "network.tint": False,
    "network.sees_mask": False,
}
RESOLUTIONS = ("32", "64", "128")  # variants that set the side of images and volume


@dataclasses.dataclass(frozen=True)
class Size:
    """A size of all experiments.

    Attributes:
      name: of --size.
      variant: put before that of every row.
      categories, seeds: unless others are asked for.
      long_seeds: of the runs at 128, and of rows that say so.
      changes: "section.field": value, of every run.
      budgets: the same for runs of a budget: the variant of `RESOLUTIONS` that they
        have, or what their row says; "" for others.
      left_out: tags of rows whose runs take too long for this size.
      fewer_points: numbers of points that rows say are divided by this.
      environment: variables of the runs' processes.
      shows_quality: whether figures say how well something works, and not only that it
        runs.
    """

    name: str
    variant: str
    categories: tuple[str, ...]
    seeds: tuple[int, ...]
    long_seeds: tuple[int, ...]
    changes: Mapping[str, Any]
    budgets: Mapping[str, Mapping[str, Any]]
    left_out: frozenset[str] = frozenset()
    fewer_points: int = 1
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)
    shows_quality: bool = True


QUICK = Size(
    "quick",
    variant="",
    categories=("chair",),  # programs do not depend on the category
    seeds=(0,),  # shows that all runs, not how well
    long_seeds=(0,),
    changes={
        **_PLAIN,
        "data.models": 12,  # rendered in seconds
        "data.val_models": 4,
        "data.test_models": 4,
        "data.surface_points": 2000,  # Chamfer distances in milliseconds
        "network.channels": 4,
        "network.hidden": 32,
        "network.shape_hidden": 32,
        "network.voxel_channels": 4,
        "network.map_channels": 8,
        "render.keep_levels": 1,  # one stage, one program to compile
        "render.num_points": 200,
        "pose.choice_points": 0,
        "pose.choice_grid": 0,
        "train.steps": 10,  # enough to log, validate, save
        "train.warmup_steps": 2,
        "train.repulsion_points": 50,
        "log.every": 5,
        "log.evaluate": 0,  # the last step has one anyhow
        "log.examples": 1,  # a report's pictures take as long as the training
    },
    budgets={
        # Images of half the side named, the least that the encoder takes, and volumes
        # of a quarter.
        "32": {"data.image_size": 16, "render.grid": 8},
        "64": {"data.image_size": 32, "render.grid": 16},
        "128": {"data.image_size": 64, "render.grid": 32},
        "longer": {"data.image_size": 16, "render.grid": 8},
        "points": {"data.image_size": 32, "render.grid": 16},
        **dict.fromkeys(
            ("", "signals"),
            {"data.image_size": 32, "render.grid": 16, "render.fine_grid": 0},
        ),
    },
    fewer_points=20,
    # Programs run for seconds: compiling them takes 11 s of a core instead of 23.
    environment={"JAX_DISABLE_MOST_OPTIMIZATIONS": "true"},
    shows_quality=False,
)

CPU = Size(
    "cpu",
    variant="",
    categories=("chair", "car"),  # the two whose silhouettes differ most
    seeds=(0, 1, 2),  # a spread needs three
    long_seeds=(0,),  # over ten minutes a run
    changes={
        **_PLAIN,
        "network.shape_hidden": 512,  # of all categories, whatever their configs have
        "render.keep_end": 1.0,
        "log.evaluate": 500,  # a curve of eight points at the least
        "log.checkpoint": 500,  # half a minute is lost at the most
    },
    budgets={
        # The same steps at every resolution: a column of Table 1 differs in nothing
        # else.
        "32": {"train.steps": 2000},
        "64": {"train.steps": 2000},
        "128": {"train.steps": 2000},
        # A step of points takes a third of the time of one of 32³ cells.
        "longer": {"train.steps": 6000},
        # A render of 200 covariances takes 70 ms: four minutes and a half a run.
        "points": {"train.steps": 1000, "train.views_per_batch": 2},
        # A render with colours takes four to six times as long as one without.
        "signals": {"train.steps": 4000, "render.num_points": 2000},
        # The steps are the config's own; as many points as in the paper at 32².
        "": {"render.num_points": 2000},
    },
    left_out=frozenset({"covariance2000"}),  # an hour by their renders
)

FULL = Size(
    "full",
    variant="paper",
    categories=("airplane", "car", "chair"),  # § Datasets
    seeds=(0,),  # the paper names none; a run takes days
    long_seeds=(0,),
    changes={},
    budgets=dict.fromkeys(("32", "64", "128", "longer", "points", "signals", ""), {}),
)

SIZES = {size.name: size for size in (QUICK, CPU, FULL)}
