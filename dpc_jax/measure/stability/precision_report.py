"""The part of the report on ordinary scenes: what float32 costs, and how it grows."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp

from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability import error_growth, figures
from dpc_jax.measure.stability.error_growth import EXPECTED, SLACK, Curve
from dpc_jax.measure.stability.precision import METHODS, Comparison, compare_scenes
from dpc_jax.measure.stability.report_parts import (
    PartRequest,
    PartResult,
    start_section,
)
from dpc_jax.reporting.tables import format_table

FIGURE = "stability_growth.png"
# Largest errors relative to the largest magnitude, in units of float32's epsilon. On
# a processor with AVX-512 the worst image was wrong by 4 and the worst gradient by 140:
# sums of terms of both signs, most of which cancel. These are four and eight times
# that, because terms cancel differently in another scene.
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 16, 1024
_EPSILON = float(jnp.finfo("float32").eps)


@dataclasses.dataclass(frozen=True)
class _Plan:
    """How much is measured."""

    points: int = 600  # of each scene
    scenes: int = 4
    methods: int = len(METHODS)  # of rendering
    sizes: tuple[int, ...] = (100, 1000, 10_000, 100_000)  # sums of points, of pixels
    sides: tuple[int, ...] = (16, 32, 64, 128)  # of volumes, in cells
    lengths: tuple[int, ...] = (16, 64, 256, 1024, 4096)  # of rays, in cells
    seeds: int = 8  # of each sum


_FULL = _Plan()
# One method, no sum over points: half a dozen programs to compile. Exponents are rough.
_QUICK = _Plan(200, 1, 1, sizes=(), sides=(16, 48), lengths=(16, 256))


def run_part(request: PartRequest) -> PartResult:
    """Compare float32 with float64 on ordinary scenes and in growing sums."""
    plan = _QUICK if request.quick else _FULL
    count, methods = plan.points, METHODS[: plan.methods]
    scenes = make_scenes(num_points=count, num_sparse=count, seed=request.seed)
    scenes = scenes[: plan.scenes]
    comparisons = list(compare_scenes(scenes, methods=methods, count=count))
    curves = _measure_growth(plan)
    figures.draw_growth(curves, request.out / FIGURE)
    failures = judge(comparisons, curves)
    data = {
        "comparisons": [c._asdict() for c in comparisons],
        "growth": [c._asdict() for c in curves],
    }
    section = _write_section(comparisons, curves, failures)
    return PartResult(section, data, tuple(failures))


def _measure_growth(plan):
    sizes, seeds, curves = plan.sizes, plan.seeds, []
    if sizes:
        curves += error_growth.measure_points(sizes, seeds=seeds)
        curves += error_growth.measure_images(sizes, seeds=seeds)
    curves += error_growth.measure_cells(plan.sides, seeds=seeds)
    return curves + error_growth.measure_rays(plan.lengths, seeds=seeds)


def judge(comparisons: Sequence[Comparison], curves: Sequence[Curve]) -> list[str]:
    """A sentence for each number outside its tolerance; NaN is outside."""
    failures = []
    for c in comparisons:
        is_image = c.quantity == "image"
        tolerance = (IMAGE_TOLERANCE if is_image else GRADIENT_TOLERANCE) * _EPSILON
        if not c.error <= tolerance:
            what = "image" if is_image else f"gradient of {c.quantity}"
            failures.append(
                f"ordinary scenes, {c.method}, {c.scene}, {c.signal}: the {what} has "
                f"an error of {c.error:.1e} in float32, the tolerance is "
                f"{tolerance:.1e}."
            )
    return failures + [
        f"sums of {curve.subject}, {curve.quantity}: the error grows as n to the "
        f"{curve.exponent:.2f}, the tolerance is {EXPECTED + SLACK:.1f}."
        for curve in curves
        if not curve.passes
    ]


def _write_section(comparisons, curves, failures):
    scenes = dict.fromkeys(c.scene for c in comparisons)
    lines = [
        *start_section("Ordinary scenes in float32", failures),
        f"Scenes {', '.join(scenes)}; volume 32³; the same inputs in float64 are the "
        "reference. An error is the largest difference relative to the largest "
        f"magnitude of the array. Tolerances: images {IMAGE_TOLERANCE * _EPSILON:.1e}, "
        f"gradients {GRADIENT_TOLERANCE * _EPSILON:.1e} ({IMAGE_TOLERANCE} and "
        f"{GRADIENT_TOLERANCE} epsilons: 4 and 8 times the worst of the first "
        "measurement). Each cell is the worst of all scenes; "
        "the worst gradient is named.",
        "",
        _tabulate_errors(comparisons),
        "### Growth with the number of terms",
        "",
        "Root mean square over seeds of ‖a − b‖/‖b‖, a in float32 and b in float64. "
        "Independent rounding errors add up as √n: an exponent above "
        f"{EXPECTED} + {SLACK} fails (the slack is twice the scatter of an exponent "
        "from so few sizes and seeds).",
        "",
        f"![error over n]({FIGURE})",
        "",
        _tabulate_growth(curves),
    ]
    if any("trilinear" in curve.quantity for curve in curves):
        lines += [
            "Trilinear weights have a derivative that jumps where a point passes a "
            "cell's centre. In some seeds one of 10⁵ points lies within rounding of a "
            "centre, and float32 puts it on the other side. This is the step in the "
            "error of the rotation's gradient; the sum is not its cause.",
        ]
    return "\n".join(lines)


def _tabulate_errors(comparisons):
    rows = []
    for key in dict.fromkeys((c.method, c.signal) for c in comparisons):
        group = [c for c in comparisons if (c.method, c.signal) == key]
        image = max(c.error for c in group if c.quantity == "image")
        gradients = [c for c in group if c.quantity != "image"]
        worst = max(gradients, key=lambda c: c.error)
        of = f"{worst.quantity} ({worst.scene})"
        rows.append((*key, f"{image:.1e}", f"{worst.error:.1e}", of))
    return format_table(("method", "signal", "image", "worst gradient", "of"), rows)


def _tabulate_growth(curves):
    rows = []
    for c in curves:
        exponent = f"{c.exponent:.2f}" if c.passes else f"**{c.exponent:.2f}**"
        errors = (f"{c.errors[0]:.1e}", f"{c.errors[-1]:.1e}")
        ends = (c.sizes[0], c.sizes[-1])
        rows.append((c.subject, c.quantity, *ends, *errors, exponent))
    head = ("n", "quantity", "from n", "to n", "error at first", "at last", "exponent")
    return format_table(head, rows)
