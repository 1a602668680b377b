"""Supervision by depth and by colour: the rows, and what is asked of pairs of them."""

from dpc_jax.experiments import published
from dpc_jax.experiments.declarations import Experiment, Row
from dpc_jax.experiments.row_settings import (
    BESIDE,
    CHOOSE_BY_ALL,
    CONTAINED,
    DEFAULTS,
    POSES,
)

_DEFAULTS = Row(
    "Defaults of this package, silhouettes",
    variant="",
    changes=DEFAULTS,
    tag="defaults",
)
SIGNAL_EXPERIMENTS = (
    Experiment(
        "color",
        "Supervision by colour",
        "Does colour tell the front from the back, and what does it cost the shape?",
        published.SUPERVISION,
        ("chamfer", *POSES, "flip_share", "color_psnr"),
        (
            Row("Silhouettes", variant="", budget="signals"),
            Row(
                "With colour, chosen by silhouettes", variant="color", budget="signals"
            ),
            Row(
                "With colour, chosen by both",
                variant="color",
                changes=CHOOSE_BY_ALL,
                tag="choose-by-all",
                budget="signals",
            ),
            _DEFAULTS,
            Row(
                "Defaults of this package, with colour, chosen by both",
                variant="color",
                changes=DEFAULTS | BESIDE | CHOOSE_BY_ALL,
                tag="defaults",
            ),
            Row("Known pose, silhouettes", variant="known_pose,32"),
            Row("Known pose, with colour", variant="known_pose,32,color"),
            Row(
                "Known pose, with colour that moves no points",
                variant="known_pose,32,color",
                changes=BESIDE,
                tag="beside",
            ),
        ),
        categories=("car", "chair"),
        picture="signals.png",
    ),
    Experiment(
        "depth",
        "Supervision by depth",
        "How much do depth maps bring over silhouettes?",
        published.SUPERVISION,
        ("chamfer", "visible_chamfer", *POSES, "depth_error_percent"),
        (
            Row("Known pose, silhouettes", variant="known_pose,32"),
            Row(
                "Known pose, contained, silhouettes",
                variant="known_pose,32",
                changes=CONTAINED,
                tag="contained",
            ),
            Row(
                "Known pose, contained, with depth",
                variant="known_pose,32,depth",
                changes=CONTAINED,
                tag="contained",
            ),
            Row(
                "Known pose, contained, depth alone",
                variant="known_pose,32,depth",
                changes=CONTAINED | {"train.silhouette_weight": 0.0},
                tag="contained-alone",
            ),
            _DEFAULTS,
            Row(
                "Defaults of this package, with depth, chosen by both",
                variant="depth",
                changes=DEFAULTS | CHOOSE_BY_ALL,
                tag="defaults",
            ),
        ),
        categories=("car", "chair"),
        picture="signals.png",
    ),
)

# Pairs of rows, without and with a signal, and what such a pair is called.
COLORED = (
    (
        "colour, chosen by silhouettes",
        "Silhouettes",
        "With colour, chosen by silhouettes",
    ),
    ("colour, chosen by both", "Silhouettes", "With colour, chosen by both"),
    (
        "defaults, colour, chosen by both",
        "Defaults of this package, silhouettes",
        "Defaults of this package, with colour, chosen by both",
    ),
    (
        "known pose, colour that moves no points",
        "Known pose, silhouettes",
        "Known pose, with colour that moves no points",
    ),
)
DEEP = (
    (
        "known pose",
        "Known pose, contained, silhouettes",
        "Known pose, contained, with depth",
    ),
    (
        "unknown pose",
        "Defaults of this package, silhouettes",
        "Defaults of this package, with depth, chosen by both",
    ),
)
