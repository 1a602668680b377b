"""What several rows have in common: metrics, and what is changed beside the variant."""

POSES = ("pose_accuracy", "pose_median_error_deg")
PULL = {"train.pull_weight": 0.03}
CONTAINED = {"train.containment_weight": 30.0}
FRAME = PULL | CONTAINED | {"pose.common_frame": True}
DEFAULTS = FRAME | {
    "pose.head": "viewpoint",
    "pose.predicted": "posterior",
    "train.reseeds_points": True,
    "network.sees_mask": True,
}
CHOOSE_BY_ALL = {"pose.choice_signals": "all"}
BESIDE = {"train.colors_move_points": False, "network.tint": True}
