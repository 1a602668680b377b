"""What an analysis measured, in words: a table with the spread over seeds."""

from collections.abc import Mapping

from dpc_jax.experiments.analyses import Analysis
from dpc_jax.experiments.point_kinds import HAND_TUNED
from dpc_jax.experiments.report.tables import Table
from dpc_jax.experiments.results import summarize

_OVER_PAIRS = "standard deviation over pairs of templates"
_OVER_SHAPES = "standard deviation over shapes"
# By experiment; what is not named here stands in a table or a file already.
LABELS: Mapping[str, Mapping[str, str]] = {
    "correspondences": {
        "right_part": "Share of transferred points on the right part",
        "right_part_spread": f"… {_OVER_PAIRS}",
        "right_part_spread_shapes": f"… {_OVER_SHAPES}",
        "distance": "Distance from the shape's own keypoint (box diagonals)",
        "distance_spread": f"… {_OVER_PAIRS}",
        "distance_spread_shapes": f"… {_OVER_SHAPES}",
        "follows": "How far points follow their keypoint (0: not, 1: all the way)",
        "follows_spread": f"… {_OVER_PAIRS}",
        "points": "Points of a keypoint",
        "radius": "Distance that counts as near (box diagonals)",
        "template_pairs": "Pairs of templates",
        "shapes": "Test shapes",
    },
    "interpolation": {
        "largest_step": "Largest step over the mean step (1: steady)",
        "detour": "Length of the points' ways over the distance of their ends",
        "distance": "Distance of the ends (box diagonals)",
        "nearest_ends": "Chamfer distance (×100) to the nearest other shape: the ends",
        "nearest_halfway": "… of what is halfway",
        "nearest_blended": "… of the mean of both ends' points",
        "pairs": "Pairs of test images",
    },
} | {
    name: {
        f"hand_tuned_sigma_{count}": f"Hand-tuned σ of {count} points (share of the "
        "volume's side)"
        for count in HAND_TUNED
    }
    for name in ("points", "covariance")
}


def make_measures(experiment: str, analysis: Analysis) -> Table | None:
    """The measures of an experiment's analysis; None where there are none."""
    labels = LABELS.get(experiment, {})
    rows = [
        (labels[name], _describe(name, analysis))
        for name in analysis.metrics
        if name in labels
    ]
    return Table(("Measure", "Value"), rows) if rows else None


def _describe(name: str, analysis: Analysis) -> str:
    """A number, with its spread where it differs between runs."""
    value = analysis.metrics[name]
    if not isinstance(value, float):
        return str(value)
    found = summarize(metrics.get(name) for metrics in analysis.runs)
    if found is None or not found.spread:
        return f"{value:.3g}"
    return f"{found.mean:.3g} ± {found.spread:.2g} (n = {found.count})"
