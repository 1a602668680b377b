"""The stress report's figures, drawn without a display."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dpc_jax.files import write_bytes
from dpc_jax.measure.stability.error_growth import Curve

_COLORS = ("#2f7ebc", "#3a9d6e", "#d1495b", "#e0a030", "#7b5ea7", "#5f6c77")
_INK, _MUTED = "#22303c", "#8795a1"


def draw_growth(curves: Sequence[Curve], path: Path) -> Path:
    """A panel for each thing counted: error over n, and √n dashed through the worst."""
    subjects = list(dict.fromkeys(curve.subject for curve in curves))
    figure = Figure(figsize=(11.0, 3.6 * -(-len(subjects) // 2)), layout="constrained")
    panels = figure.subplots(-(-len(subjects) // 2), 2, sharey=True)
    flat = np.atleast_1d(panels).ravel()
    for axes, subject in zip(flat, subjects, strict=False):
        chosen = [curve for curve in curves if curve.subject == subject]
        for i, curve in enumerate(chosen):
            axes.loglog(
                curve.sizes,
                curve.errors,
                marker="o",
                markersize=4,
                linewidth=1.2,
                color=_COLORS[i % len(_COLORS)],
                linestyle="-" if i < len(_COLORS) else ":",
                label=f"{curve.quantity}: n$^{{{curve.exponent:.2f}}}$",
            )
        sizes = np.array(chosen[0].sizes, float)
        top = max(curve.errors[0] for curve in chosen)
        axes.loglog(
            sizes,
            2 * top * (sizes / sizes[0]) ** 0.5,
            "--",
            color=_MUTED,
            label=r"$\sqrt{n}$",
        )
        axes.set_xticks(sizes, [f"{n:,.0f}" for n in sizes])
        axes.set_xticks([], minor=True)
        axes.set_xlabel(f"n {subject}", fontsize=9)
        axes.grid(which="major", color="#e3e7ea", linewidth=0.6)
        axes.legend(fontsize=7, frameon=False, loc="upper left")
    for axes in flat[len(subjects) :]:
        axes.set_visible(False)
    figure.supylabel("relative error of float32", fontsize=10)
    return _save(figure, path)


def _save(figure, path):
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return write_bytes(path, buffer.getvalue())


def draw_descents(summaries: Sequence, path: Path) -> Path:
    """Pose error and Chamfer distance over iterations and seconds, a column a scene.

    Args:
      summaries: of `stiff.summarize`; those of the study "shape" are drawn.
    """
    chosen = [s for s in summaries if s.study == "shape"]
    scenes = list(dict.fromkeys(s.scene for s in chosen))
    recipes = list(dict.fromkeys(s.recipe for s in chosen))
    figure = Figure(figsize=(5.5 * len(scenes) + 2.5, 9.0), layout="constrained")
    panels = figure.subplots(3, len(scenes), squeeze=False, sharey="row")
    for column, scene in enumerate(scenes):
        for summary in (s for s in chosen if s.scene == scene):
            style = _choose_style(summary.recipe, recipes)
            times = np.array(summary.iterations) / summary.iterations[-1]
            for row, (x, y) in enumerate(
                (
                    (summary.iterations, summary.first_errors),
                    (summary.iterations, summary.second_errors),
                    (times * summary.seconds, summary.first_errors),
                )
            ):
                panels[row, column].semilogy(x, y, label=summary.recipe, **style)
        for row, (x, y) in enumerate(
            (
                ("iteration", "median pose error, °"),
                ("iteration", "Chamfer distance ×100"),
                ("run time, s", "median pose error, °"),
            )
        ):
            axes = panels[row, column]
            axes.set_xlabel(x, fontsize=9)
            axes.set_ylabel(y if column == 0 else "", fontsize=9)
            axes.grid(which="major", color="#e3e7ea", linewidth=0.6)
        panels[0, column].set_title(scene, fontsize=10, color=_INK)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside right center", fontsize=8, frameon=False
    )
    return _save(figure, path)


def _choose_style(recipe, recipes):
    """Colour by sigma, dashed for plain gradient descent."""
    kinds = list(dict.fromkeys(r.partition(", ")[2] for r in recipes))
    palette = (*_COLORS, _INK)
    return {
        "color": palette[kinds.index(recipe.partition(", ")[2]) % len(palette)],
        "linestyle": "--" if recipe.startswith("gradient") else "-",
        "linewidth": 2.2 if "→" in recipe and "Adam" in recipe else 1.1,
    }


def draw_others(summaries: Sequence, choices: Sequence, path: Path) -> Path:
    """Heavy and light points over iterations; pose error over the number of starts."""
    chosen = [s for s in summaries if s.study == "masses"]
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    heavy, light, starts = figure.subplots(1, 3)
    for summary, color in zip(chosen, _COLORS, strict=False):
        for axes, errors in (
            (heavy, summary.first_errors),
            (light, summary.second_errors),
        ):
            axes.semilogy(summary.iterations, errors, color=color, label=summary.recipe)
    for axes, words in ((heavy, "heaviest third"), (light, "lightest third")):
        axes.set_xlabel("iteration", fontsize=9)
        axes.set_ylabel(f"distance ×100, {words}", fontsize=9)
    heavy.legend(fontsize=8, frameon=False)
    scenes = list(dict.fromkeys(c.scene for c in choices))
    for scene, color in zip(scenes, _COLORS, strict=False):
        found = [c for c in choices if c.scene == scene]
        starts.loglog(
            [c.starts for c in found],
            [c.median_error for c in found],
            "o-",
            color=color,
            label=scene,
        )
    counts = sorted({c.starts for c in choices})
    starts.set_xticks(counts, [str(c) for c in counts])
    starts.set_xticks([], minor=True)
    starts.set_xlabel("K starts from random rotations", fontsize=9)
    starts.set_ylabel("median pose error of the best, °", fontsize=9)
    starts.legend(fontsize=8, frameon=False)
    for axes in (heavy, light, starts):
        axes.grid(which="major", color="#e3e7ea", linewidth=0.6)
    return _save(figure, path)
