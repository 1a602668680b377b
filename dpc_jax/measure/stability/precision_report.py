"""The part of the report on ordinary scenes: what float32 costs, and how it grows."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp

from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability import error_growth, figures
from dpc_jax.measure.stability.precision import METHODS, Comparison, compare_scenes
from dpc_jax.measure.stability.report_parts import Order, PartResult

FIGURE = "stability_growth.png"
# Largest errors relative to the largest magnitude, in units of float32's epsilon. On
# a processor with AVX-512 the worst image was wrong by 4 and the worst gradient by 140:
# sums of terms of both signs, most of which cancel. Four and eight times that, because
# the next scene cancels otherwise.
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 16, 1024
_EPSILON = float(jnp.finfo("float32").eps)


@dataclasses.dataclass(frozen=True)
class Plan:
    """How much is measured.

    Attributes:
      points: of each scene. scenes: how many. methods: of rendering, how many.
      sizes: numbers of points in a sum; pixels too. summed: methods that sum them.
      sides: of volumes. lengths: of rays. seeds: of each sum.
    """

    points: int
    scenes: int
    methods: int
    sizes: tuple[int, ...]
    summed: tuple[str, ...]
    sides: tuple[int, ...]
    lengths: tuple[int, ...]
    seeds: int


FULL = Plan(
    points=600,
    scenes=4,
    methods=len(METHODS),
    sizes=(100, 1000, 10_000, 100_000),
    summed=("trilinear", "gaussian"),
    sides=(16, 32, 64, 128),
    lengths=(16, 64, 256, 1024, 4096),
    seeds=8,
)
# One method, no sum over points: half a dozen programs to compile.
QUICK = Plan(
    points=200,
    scenes=1,
    methods=1,
    sizes=(),
    summed=(),
    sides=(16, 48),
    lengths=(16, 256),
    seeds=8,
)


def run_part(order: Order) -> PartResult:
    """The part in full; see `parts.run_part`."""
    return run(order.out, quick=False, seed=order.seed)


def run(out: Path, *, quick: bool, seed: int = 0) -> PartResult:
    """Compare float32 with float64 on ordinary scenes and in growing sums.

    Args:
      out: folder of the figure.
      quick: a small part of both, in seconds; the exponents are rough then.
      seed: of the scenes.
    """
    plan = QUICK if quick else FULL
    scenes = make_scenes(num_points=plan.points, num_sparse=plan.points, seed=seed)
    comparisons = list(
        compare_scenes(
            scenes[: plan.scenes], methods=METHODS[: plan.methods], count=plan.points
        )
    )
    curves = measure_growth(plan)
    figures.draw_growth(curves, Path(out) / FIGURE)
    failures = judge(comparisons, curves)
    return PartResult(
        markdown=write_section(comparisons, curves, failures),
        data={
            "comparisons": [c._asdict() for c in comparisons],
            "growth": [c._asdict() for c in curves],
        },
        passes=not failures,
        failures=tuple(failures),
    )


def measure_growth(plan: Plan) -> list[error_growth.Curve]:
    """All sums of a plan."""
    curves = []
    if plan.sizes:
        curves += error_growth.measure_points(
            plan.sizes, methods=plan.summed, seeds=plan.seeds
        )
        curves += error_growth.measure_images(plan.sizes, seeds=plan.seeds)
    curves += error_growth.measure_cells(plan.sides, seeds=plan.seeds)
    return curves + error_growth.measure_rays(plan.lengths, seeds=plan.seeds)


def judge(
    comparisons: Sequence[Comparison], curves: Sequence[error_growth.Curve]
) -> list[str]:
    """A sentence for each number outside its tolerance; NaN is outside."""
    failures = []
    for c in comparisons:
        tolerance = find_tolerance(c)
        if not c.error <= tolerance:
            what = "image" if c.quantity == "image" else f"gradient of {c.quantity}"
            failures.append(
                f"ordinary scenes, {c.method}, {c.scene}, {c.signal}: the {what} has "
                f"an error of {c.error:.1e} in float32, the tolerance is "
                f"{tolerance:.1e}."
            )
    for curve in curves:
        if not curve.passes:
            failures.append(
                f"sums of {curve.subject}, {curve.quantity}: the error grows as n to "
                f"the {curve.exponent:.2f}, the tolerance is "
                f"{error_growth.EXPECTED + error_growth.SLACK:.1f}."
            )
    return failures


def find_tolerance(comparison: Comparison) -> float:
    """Largest relative error of an image or gradient."""
    is_image = comparison.quantity == "image"
    return (IMAGE_TOLERANCE if is_image else GRADIENT_TOLERANCE) * _EPSILON


def write_section(
    comparisons: Sequence[Comparison],
    curves: Sequence[error_growth.Curve],
    failures: Sequence[str],
) -> str:
    """Section of the report: worst errors, then growth with its figure."""
    scenes = dict.fromkeys(c.scene for c in comparisons)
    lines = ["## Ordinary scenes in float32", ""]
    if failures:
        lines += ["**Outside tolerance:**", "", *(f"- {f}" for f in failures), ""]
    lines += [
        f"Scenes {', '.join(scenes)}; volume 32³; the same inputs in float64 are the "
        "reference. An error is the largest difference relative to the largest "
        f"magnitude of the array. Tolerances: images {IMAGE_TOLERANCE * _EPSILON:.1e}, "
        f"gradients {GRADIENT_TOLERANCE * _EPSILON:.1e} ({IMAGE_TOLERANCE} and "
        f"{GRADIENT_TOLERANCE} epsilons: 4 and 8 times the worst of the first "
        "measurement). Each cell is the worst of all scenes; "
        "the worst gradient is named.",
        "",
        "| method | signal | image | worst gradient | of |",
        "|---|---|---:|---:|---|",
    ]
    for method in dict.fromkeys(c.method for c in comparisons):
        for signal in dict.fromkeys(c.signal for c in comparisons):
            chosen = [
                c for c in comparisons if (c.method, c.signal) == (method, signal)
            ]
            image = max(c.error for c in chosen if c.quantity == "image")
            worst = max(
                (c for c in chosen if c.quantity != "image"), key=lambda c: c.error
            )
            lines.append(
                f"| {method} | {signal} | {image:.1e} | {worst.error:.1e} | "
                f"{worst.quantity} ({worst.scene}) |"
            )
    lines += [
        "",
        "### Growth with the number of terms",
        "",
        "Root mean square over seeds of ‖a − b‖/‖b‖, a in float32 and b in float64. "
        "Rounding errors that know nothing of each other add up as √n: an exponent "
        f"above {error_growth.EXPECTED} + {error_growth.SLACK} fails (the slack is "
        "twice the scatter of an exponent from so few sizes and seeds).",
        "",
        f"![error over n]({FIGURE})",
        "",
        "| n | quantity | from n | to n | error at first | at last | exponent |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for curve in curves:
        exponent = f"{curve.exponent:.2f}"
        lines.append(
            f"| {curve.subject} | {curve.quantity} | {curve.sizes[0]} | "
            f"{curve.sizes[-1]} | {curve.errors[0]:.1e} | {curve.errors[-1]:.1e} | "
            f"{exponent if curve.passes else f'**{exponent}**'} |"
        )
    if any("trilinear" in curve.quantity for curve in curves):
        lines += [
            "",
            "Trilinear weights have a derivative that jumps where a point passes a "
            "cell's centre. Of 10⁵ points one in some seeds lies within rounding of a "
            "centre, and float32 takes the other side: that is the step in the error "
            "of the rotation's gradient, not the sum.",
        ]
    return "\n".join(lines) + "\n"
