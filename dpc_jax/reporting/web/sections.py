"""The sections of the report's page: their titles, how to read them, their tables."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

from dpc_jax.evaluation import metrics as registry
from dpc_jax.reporting.examples import TrainingComparison
from dpc_jax.reporting.web.markup import make_table, show_hint

_NAMED = 30  # objects
CAPTIONS = {
    "predictions": (
        "Predictions on test views",
        "Views that the network never trained on. All shapes are lit and seen from the "
        "same direction, whatever the input's; numbers below them are Chamfer "
        "distances (× 100) to the true shape, where there is one.",
    ),
    "worst_objects": (
        "The worst objects",
        "What is wrong with them says what to mend: the difference is red where the "
        "prediction is too large and blue where it is too small, both as seen from the "
        "predicted pose; the true shape is on the right.",
    ),
    "pose_errors": (
        "Pose errors",
        "The angle between predicted and true pose over all test views. Good poses "
        "pile up at the left, blue bars count as accurate; a second pile near 180°, in "
        "amber, are views with front and back exchanged.",
    ),
    "azimuths": (
        "Pose errors over azimuth",
        "Each point is a test view. A band at the top left, or on a dotted line at the "
        "right, over a range of azimuths is a part of the poses that the network has "
        "learned the wrong way round; single points are single objects.",
    ),
    "training_shapes": (
        "Beside the training set",
        "Chamfer distances (× 100) to true shapes and to predictions from the first "
        "view of each object. A network that copies predicts shapes much nearer to a "
        "training shape than to the truth. One that ignores its input is no nearer to "
        "the truth than the mean shape, and its predictions of different objects, in "
        "the last line, are nearer to each other than the true shapes are. Training "
        "shapes are true surfaces, parts inside of objects too; the network learns "
        "from images.",
    ),
    "curves": (
        "Over run time",
        "Poses, Chamfer distance, silhouettes and stray points are of validation, "
        "those of which the truth is known: the same size of "
        "points and the same grid all along, so these curves mean the same from left "
        "to right. The loss does not: at the dotted lines the number of points and the "
        "grid change, and between them the points become smaller, so it may climb "
        "while everything improves. An accuracy that settles near 50 % hints at "
        "flipped poses; a curve still moving at its right end asks for more steps.",
    ),
    "candidates": (
        "Pose candidates",
        "How often each member of the pose ensemble explains a view best. Grey bars "
        "win less than 1 % and have stopped learning; with a single bar left the "
        "ensemble works like one regressor.",
    ),
    "signals": (
        "Rendered images",
        "Each signal as the data have it, as the prediction looks from its predicted "
        "pose, and the difference: red is too large or too far, blue too small or too "
        "near, and for colours the brighter, the more they differ.",
    ),
}


def introduce(name: str, more: str = "") -> str:
    """The title of a section, and how to read it."""
    title, caption = CAPTIONS[name]
    text = f"{more} {caption}" if more else caption
    return f"<h2>{html.escape(title)}</h2><p>{html.escape(text)}</p>"


def compare_with_training(comparison: TrainingComparison) -> str:
    """A table of distances to the true shapes and to the predictions."""

    def show(values, name):
        return registry.format_metric("chamfer", values.get(name))

    names = dict.fromkeys([*comparison.to_truth, *comparison.to_prediction])
    rows = [
        (
            html.escape(name),
            show(comparison.to_truth, name),
            show(comparison.to_prediction, name),
        )
        for name in names
    ]
    heads = ("", "to the true shape", "to the prediction")
    count = comparison.objects
    note = f"Means over {count} test {'object' if count == 1 else 'objects'}."
    return make_table(rows, heads, kind="numbers") + show_hint(note)


def describe_failures(values: Mapping[str, Any], lost: Sequence[str]) -> str:
    """What the wrong views are, and which objects are wrong in all of theirs."""
    names = (
        "wrong_half_turn_share",
        "wrong_mirror_share",
        "truth_cheaper_share",
        "wrong_object_share",
    )
    known = [name for name in names if values.get(name) is not None]
    rows = [
        (
            html.escape(registry.get_metric(name).heading),
            html.escape(registry.format_metric(name, values[name])),
            show_hint(registry.get_metric(name).hint),
        )
        for name in known
    ]
    text = f"<h3>What the wrong views are</h3>{make_table(rows)}" if rows else ""
    if lost:
        shown = ", ".join(lost[:_NAMED]) + (", ..." if len(lost) > _NAMED else "")
        text += f"<p>Wrong in all views: {html.escape(shown)}.</p>"
    return text


def list_metrics(values: Mapping[str, Any]) -> str:
    """A table of all metrics, each with its meaning."""
    rows = []
    for name in registry.order_metrics(values):
        metric = registry.get_metric(name)
        hint = metric.hint
        if hint and metric.higher_is_better is not None:
            hint += f"; {'higher' if metric.higher_is_better else 'lower'} is better"
        value = registry.format_metric(name, values[name])
        rows.append((html.escape(metric.heading), html.escape(value), show_hint(hint)))
    return (
        "<h2>All metrics</h2><p>Of the test split; the same numbers, unrounded and "
        'with shares from 0 to 1, are in <a href="metrics.json">metrics.json</a>.</p>'
        + make_table(rows)
    )


def show_config(text: str) -> str:
    """The configuration, folded away."""
    return (
        "<h2>Configuration</h2><details><summary>Show the settings of this run"
        f"</summary><pre>{html.escape(text)}</pre></details>\n"
    )
