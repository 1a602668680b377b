"""The part of the report on stiff optimisation: what crawls, and what helps."""

from collections.abc import Sequence

import jax
import numpy as np

from dpc_jax.measure.stability import figures
from dpc_jax.measure.stability.report_parts import (
    PartRequest,
    PartResult,
    start_section,
)
from dpc_jax.measure.stability.stiff import studies, summaries
from dpc_jax.measure.stability.stiff.studies import BEST, STAGED, Run
from dpc_jax.measure.stability.stiff.summaries import Choice, Summary
from dpc_jax.reporting.tables import format_table

SHAPE_FIGURE, OTHER_FIGURE = "stability_stiff_shape.png", "stability_stiff_other.png"
# Final errors of the best recipe, first and second, and the most that they may be.
_BOUNDS = {
    # Medians over seeds: a fifth above the worst single seed of the first measurement
    # (6.7°, 7.8), because descents are chaotic and another processor rounds
    # differently. They start at 30° and at 12 to 15.
    "shape": (("pose error (degrees)", 8.0), ("Chamfer distance (x100)", 9.5)),
    # Of the heaviest and lightest third: the worst seed came from 3.6 and 3.0 to 0.0029
    # and 0.94. These are several times the first and half as much again as the second.
    "masses": (
        ("distance of heavy points (x100)", 0.02),
        ("distance of light points (x100)", 1.5),
    ),
}
# Smallest share of views within 30° with all starts. Measured were 0.56 and 0.72 of 18
# views, uncertain by 0.12 (binomial); a single start reaches a sixth.
ACCURACY_BOUND = 0.4


def run_part(request: PartRequest) -> PartResult:
    """Descend on stiff problems; writes two figures.

    The quick form takes a tenth of the iterations on one scene and seed. Then numbers
    must be finite and losses must fall, and no more is asked for.
    """
    plan = studies.QUICK if request.quick else studies.FULL
    runs: list[Run] = []
    for study in (studies.run_shapes, studies.run_starts, studies.run_masses):
        runs += study(plan)
        request.tell(f"stiff, {runs[-1].study}: {len(runs)} descents so far")
    found, choices = summaries.summarize(runs), summaries.choose_starts(runs)
    figures.draw_descents(found, request.out / SHAPE_FIGURE)
    figures.draw_masses_and_starts(found, choices, request.out / OTHER_FIGURE)
    failures = judge(runs, found, choices, is_full=not request.quick)
    data = {
        "summaries": [s._asdict() for s in found],
        "starts": [c._asdict() for c in choices],
    }
    section = _write_section(found, choices, failures, plan)
    return PartResult(section, data, tuple(failures))


def judge(
    runs: Sequence[Run],
    summaries: Sequence[Summary],
    choices: Sequence[Choice],
    *,
    is_full: bool,
) -> list[str]:
    """A sentence for each run that is not finite, and each best recipe that fails.

    The bounds belong to the full number of iterations. The loss of the best recipes
    must fall in any case.
    """
    failures = []
    for r in runs:
        if not all(np.all(np.isfinite(a)) for a in jax.tree.leaves(r.trace)):
            failures.append(
                f"stiff, {r.study}, {r.scene}, {r.recipe}, rate {r.rate}, seed "
                f"{r.seed}: an error, a point or a pose is not finite."
            )
    for s in (s for s in summaries if s.recipe in (BEST, STAGED)):
        label = f"stiff, {s.study}, {s.scene}, {s.recipe}"
        if not s.losses[-1] < s.losses[0]:
            failures.append(f"{label}: the loss did not fall.")
        ends = (s.first_errors[-1], s.second_errors[-1])
        for (words, bound), error in zip(_BOUNDS[s.study], ends, strict=True):
            if is_full and not error <= bound:
                failures.append(f"{label}: {words} {error:.3g}, at most {bound:g}.")
    most = max((c.starts for c in choices), default=0)
    for c in choices:
        if is_full and c.starts == most and not c.accuracy >= ACCURACY_BOUND:
            failures.append(
                f"stiff, starts, {c.scene}: {c.accuracy:.2f} of the views are within "
                f"30° with {c.starts} starts, at least {ACCURACY_BOUND:g}."
            )
    return failures


# What the full number of iterations first showed.
SHAPES_FOUND = (
    "What the full number of iterations first showed: a fixed σ of 5 voxels drives "
    "poses and points away from the truth, because no cloud so blurred has a sharp "
    "silhouette; with a fixed 0.2 most points get no gradient; neither arrives. At "
    "σ 1 gradient descent crawls: Adam reaches its end after a quarter of the "
    "iterations. A σ that shrinks from two voxels to a half, with Adam, ends "
    "nearest in pose, at the same run time. One that begins at 5 throws points and "
    "poses away first: the chair needs half of the run to come back, and the car's "
    "poses do not come back."
)
MASSES_FOUND = (
    "What the full number of iterations first showed: gradient descent moves only "
    "the heavy points. Divided by the mass it moves all of them, the light ones "
    "slowly. Adam throws light points about while the heavy ones are wrong, whose "
    "error dominates the gradient of the light ones; when the light ones start "
    "only after the heavy ones have come to rest, with a shorter memory of the "
    "mean square, it places them."
)


def _write_section(summaries, choices, failures, plan):
    starts = []
    for c in choices:
        numbers = (c.median_error, c.accuracy, c.seconds)
        starts.append((c.scene, c.starts, *(f"{n:.2f}" for n in numbers)))
    head = ("scene", "K", "median pose error (°)", "within 30°", "run time (s)")
    lines = [
        *start_section("Stiff optimisation", failures),
        f"Medians over {plan.seeds} seeds; {plan.steps} iterations; volume 32³, "
        f"{studies.VIEWS} views, targets nearly sharp (σ 0.5). Plain gradient "
        f"descent is shown with the best of the rates tried, by its final loss. Losses "
        "are at σ 1 for every recipe.",
        "",
        "### Pose and shape from one view set, thin structures",
        "",
        f"{plan.points} points start in a ball, poses 30° off (one pose is known and "
        "holds the frame). The chair's legs are a fiftieth of its size, less than a "
        "voxel.",
        "",
        _tabulate_shapes(summaries),
        f"![error over iterations and run time]({SHAPE_FIGURE})",
        "",
        SHAPES_FOUND,
        "",
        "### K starts",
        "",
        "Poses of views of a known shape from random rotations; for each view the "
        "start with the lowest final loss is kept.",
        "",
        format_table(head, starts),
        "### Masses 10⁴ : 1",
        "",
        "24 points of masses from 10 to 0.001 voxels, displaced by 0.02 (root mean "
        "square of each coordinate), poses known. A point's curvature grows with the "
        "square of its mass, so the condition number is about 10⁸.",
        "",
        _tabulate_masses(summaries),
        f"![masses and starts]({OTHER_FIGURE})",
        "",
        MASSES_FOUND,
    ]
    return "\n".join(lines)


def _tabulate_shapes(summaries):
    rows = []
    for s in (s for s in summaries if s.study == "shape"):
        poses = s.first_errors
        rows.append(
            (
                *(s.scene, s.recipe, _show_rate(s.rate), f"{s.losses[-1]:.3g}"),
                *(f"{poses[(len(poses) - 1) // 4]:.1f}", f"{poses[-1]:.1f}"),
                *(f"{s.second_errors[-1]:.1f}", f"{s.seconds:.2f}"),
            )
        )
    head = ("scene", "recipe", "rate", "loss", "pose error at a quarter (°)")
    heads = (*head, "at the end (°)", "Chamfer ×100", "run time (s)")
    return format_table(heads, rows)


def _tabulate_masses(summaries):
    found = [s for s in summaries if s.study == "masses"]
    errors = [(s.losses, s.first_errors, s.second_errors) for s in found]
    rows = [
        ("at the start", "", *(f"{values[0]:.3g}" for values in e), "")
        for e in errors[:1]
    ]
    for s, e in zip(found, errors, strict=True):
        last = (f"{values[-1]:.2g}" for values in e)
        rows.append((s.recipe, _show_rate(s.rate), *last, f"{s.seconds:.2f}"))
    head = ("recipe", "rate", "loss", "heaviest third ×100", "lightest third ×100")
    return format_table((*head, "run time (s)"), rows)


def _show_rate(rate):
    return "" if rate is None else f"{rate:g}"
