"""The registry of metrics: how people read each number that a run reports.

Every report takes its labels, units and roundings from here: the HTML page, the
Markdown tables, the comparison of runs and the lines printed during a run. To add a
metric, add its line to `METRICS`; a name without a line is shown as it is, with four
digits.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

STDERR = "_stderr"  # ends the name of the standard error of the metric before it
MISSING = "–"
_VISIBLE = "visible_"  # begins the name of a score from what can be seen alone


@dataclass(frozen=True)
class Metric:
    """One metric and how it is shown."""

    name: str  # key in `metrics.json`
    label: str  # name for people, without the unit
    unit: str = ""  # of the number as shown; "%" of a share that is stored as 0 to 1
    format: str = ".4g"  # format specification of the number as shown
    higher_is_better: bool | None = None  # None where neither direction is better
    hint: str = ""  # one phrase on its meaning
    short: str = ""  # name within a line of text; empty: left out there
    # "required": in every report, if only as unknown; "headline": large at the top of
    # the page, too; "reference": of a shape that predictions are compared with.
    role: Literal["", "required", "headline", "reference"] = ""

    @property
    def factor(self) -> float:
        """The number is shown times this."""
        return 100.0 if self.unit == "%" else 1.0

    @property
    def heading(self) -> str:
        """The label with its unit in brackets."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


# fmt: off
METRICS = {metric.name: metric for metric in (
    Metric("pose_accuracy", "Pose accuracy", "%", ".1f", True,
           "views posed within 30° of the truth", "pose accuracy", role="headline"),
    Metric("pose_median_error_deg", "Median pose error", "°", ".1f", False,
           "half of the views are closer than this", "median error", role="headline"),
    Metric("chamfer", "Chamfer distance", "×100", ".2f", False,
           "precision plus coverage", "Chamfer", role="headline"),
    Metric("precision", "Precision", "×100", ".2f", False,
           "mean distance from prediction to truth", role="required"),
    Metric("coverage", "Coverage", "×100", ".2f", False,
           "mean distance from truth to prediction", role="required"),
    Metric("visible_chamfer", "Chamfer distance, what can be seen", "×100", ".2f",
           False, "the same from and to the part of a surface seen from outside",
           "visible"),
    Metric("visible_precision", "Precision, what can be seen", "×100", ".2f", False),
    Metric("visible_coverage", "Coverage, what can be seen", "×100", ".2f", False),
    Metric("chamfer_gain", "Way from the mean shape to a perfect cloud", "%", ".0f",
           True, "how much of it predictions go; below 0: the mean shape is better"),
    Metric("visible_chamfer_gain", "Way from the mean shape to a perfect cloud, what "
           "can be seen", "%", ".0f", True, short="way from the mean shape"),
    Metric("floor_chamfer", "Chamfer distance, perfect cloud", "×100", ".2f", False,
           "as many true points as are predicted", role="reference"),
    Metric("mean_shape_chamfer", "Chamfer distance, mean training shape", "×100", ".2f",
           False, "sees no image, but true surfaces", role="reference"),
    Metric("nearest_shape_chamfer", "Chamfer distance, nearest training shape", "×100",
           ".2f", False, "the nearest to the truth, as many points", role="reference"),
    Metric("own_mean_chamfer", "Chamfer distance, mean of the predictions", "×100",
           ".2f", False, "what the network says without an image", role="reference"),
    Metric("stray_points", "Stray points", "", ".1f", False,
           "of a predicted shape, further than a tenth of its box from four others"),
    Metric("flip_share", "Flipped views", "%", ".1f", False,
           "wrong by more than 150°: front and back exchanged"),
    Metric("wrong_object_share", "Objects wrong in all views", "%", ".1f", False,
           "of the objects, those of several views"),
    Metric("wrong_half_turn_share", "Wrong views that are half turns", "%", ".1f",
           hint="within 30° of the true pose turned about the up axis"),
    Metric("wrong_mirror_share", "Wrong views that are mirror poses", "%", ".1f",
           hint="within 30° of the pose of nearly the same silhouette"),
    Metric("best_candidate_pose_accuracy", "Pose accuracy, best candidate", "%", ".1f",
           True, "the winner of the ensemble"),
    Metric("best_candidate_pose_median_error_deg", "Median pose error, best candidate",
           "°", ".1f", False, "the winner of the ensemble"),
    Metric("silhouette_iou", "Silhouette overlap", "%", ".1f", True,
           "intersection over union with the masks", "silhouette overlap"),
    Metric("projection_error", "Projection error", "", ".4f", False,
           "squared difference of silhouettes per pixel, at 32×32 pixels"),
    Metric("depth_error", "Depth error", "box diagonals", ".4f", False,
           "mean over the pixels that the true mask covers", role="required"),
    Metric("depth_error_percent", "Depth error, of the box diagonal", "percent", ".2f",
           False, "mean over the pixels that the true mask covers", "depth error",
           role="required"),
    Metric("color_psnr", "Colour PSNR", "dB", ".2f", True, "inside the true mask",
           "colour PSNR", role="required"),
    Metric("translation_error", "Translation error", "box diagonals", ".4f", False,
           "mean distance from the true place in the camera frame", role="required"),
    Metric("focal_length_error_percent", "Focal length error", "percent", ".2f", False,
           "mean, of the true focal length", role="required"),
    Metric("train_seconds", "Training time", "s", ".0f", False,
           "wall clock, including compilation", role="headline"),
    Metric("peak_memory_gb", "Peak memory", "GB", ".1f", False,
           "of the training process"),
    Metric("data_seconds", "Time for the data", "s", ".0f", False,
           "reading or rendering, before training"),
    Metric("steps", "Training steps", "", ".0f"),
    Metric("train_models", "Training objects", "", ".0f"),
    Metric("test_models", "Test objects", "", ".0f"),
    Metric("candidates_alive", "Candidates alive", "", ".0f", True,
           "heads of the ensemble that win at least 1 % of the views"),
    Metric("alignment_inlier_share", "Views that agree on the frame", "%", ".1f", True,
           "of validation, within 30° after the alignment"),
    Metric("surface_threshold", "Surface threshold", "", ".3f",
           hint="occupancy at which surfaces of voxel models are drawn"),
    Metric("loss", "Training loss", higher_is_better=False),
)}
# fmt: on
HEADLINE_METRICS = tuple(n for n, m in METRICS.items() if m.role == "headline")
REQUIRED_METRICS = tuple(
    n for n, m in METRICS.items() if m.role in ("headline", "required")
)


def get_metric(name: str) -> Metric:
    """The metric of that name; an unknown one has its name as its label."""
    if name in METRICS:
        return METRICS[name]
    if name.endswith(STDERR):
        metric = get_metric(name.removesuffix(STDERR))
        label = f"{metric.label}, standard error over objects"
        return replace(metric, name=name, label=label, hint="")
    plain = name.removeprefix(_VISIBLE)
    if plain != name and plain in METRICS:
        metric = METRICS[plain]
        return replace(metric, name=name, label=f"{metric.label}, what can be seen")
    return Metric(name, name)


def order_metrics(names: Iterable[str]) -> list[str]:
    """Distinct names in the registry's order, then the others alphabetically."""
    given = set(names)
    return [n for n in METRICS if n in given] + sorted(given - METRICS.keys())


def format_metric(name: str, value: Any) -> str:
    """A metric's value in its unit and rounding; an en dash for None, NaN, infinity."""
    if isinstance(value, bool | str):
        return str(value)
    if value is None or not math.isfinite(value):
        return MISSING
    metric = get_metric(name)
    return format(metric.factor * float(value), metric.format)


def describe_metrics(metrics: Mapping[str, Any], *, share_digits: int = 3) -> str:
    """One line of text: "pose accuracy 0.886, median error 2.5°, Chamfer 3.31".

    What is missing or None is left out. Shares are stated from 0 to 1, with
    `share_digits` decimal places.
    """
    parts = []
    for name, metric in METRICS.items():
        value = metrics.get(name)
        if metric.short and value is not None:
            spec = f".{share_digits}f" if metric.unit == "%" else metric.format
            sign = "°" if metric.unit == "°" else ""
            error = metrics.get(name + STDERR)
            spread = "" if error is None else f" ± {error:{spec}}"
            parts.append(f"{metric.short} {value:{spec}}{spread}{sign}")
    return ", ".join(parts)
