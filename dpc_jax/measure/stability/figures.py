"""The stress report's figures, drawn without a display."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.measure.stability.error_growth import Curve
from dpc_jax.measure.stability.stiff.summaries import Choice, Summary
from dpc_jax.reporting.style import (
    INK,
    MUTED,
    SERIES,
    label_axes,
    make_figure,
    make_panels,
    save_figure,
    set_ticks,
)

_LEGEND = {"fontsize": 8, "frameon": False}


def draw_growth(curves: Sequence[Curve], path: Path) -> Path:
    """A panel for each thing counted: error over n, and √n dashed above the worst."""
    subjects = list(dict.fromkeys(curve.subject for curve in curves))
    figure = make_figure(11.0, 3.6 * -(-len(subjects) // 2))
    panels = make_panels(figure, len(subjects))
    for axes, subject in zip(panels, subjects, strict=True):
        chosen = [curve for curve in curves if curve.subject == subject]
        for i, curve in enumerate(chosen):
            label = f"{curve.quantity}: n$^{{{curve.exponent:.2f}}}$"
            color = SERIES[i % len(SERIES)]
            line = "o-" if i < len(SERIES) else "o:"
            axes.loglog(curve.sizes, curve.errors, line, ms=4, color=color, label=label)
        sizes = np.array(chosen[0].sizes, float)
        root = 2 * max(c.errors[0] for c in chosen) * (sizes / sizes[0]) ** 0.5
        axes.loglog(sizes, root, "--", color=MUTED, label=r"$\sqrt{n}$")
        if axes is not panels[0]:
            axes.sharey(panels[0])
        label_axes(axes, x_label=f"n {subject}", grid="both")
        set_ticks(axes, sizes, ",.0f")
        axes.legend(loc="upper left", **_LEGEND)
    figure.supylabel("relative error of float32", fontsize=10)
    return save_figure(figure, path)


def draw_descents(summaries: Sequence[Summary], path: Path) -> Path:
    """Study "shape": pose error and Chamfer distance over iterations and seconds."""
    chosen = [s for s in summaries if s.study == "shape"]
    scenes = list(dict.fromkeys(s.scene for s in chosen))
    recipes = list(dict.fromkeys(s.recipe for s in chosen))
    figure = make_figure(5.5 * len(scenes) + 2.5, 9.0)
    panels = figure.subplots(3, len(scenes), squeeze=False, sharey="row")
    for (poses, chamfer, over_time), scene in zip(panels.T, scenes, strict=True):
        for s in (s for s in chosen if s.scene == scene):
            style = {"label": s.recipe, **_choose_style(s.recipe, recipes)}
            seconds = np.array(s.iterations) / s.iterations[-1] * s.seconds
            poses.semilogy(s.iterations, s.first_errors, **style)
            chamfer.semilogy(s.iterations, s.second_errors, **style)
            over_time.semilogy(seconds, s.first_errors, **style)
        for axes, x_label, y_label, title in (
            (poses, "iteration", "median pose error, °", scene),
            (chamfer, "iteration", "Chamfer distance ×100", ""),
            (over_time, "run time, s", "median pose error, °", ""),
        ):
            y_label *= scene == scenes[0]
            label_axes(axes, title=title, x_label=x_label, y_label=y_label, grid="both")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", **_LEGEND)
    return save_figure(figure, path)


def _choose_style(recipe, recipes):
    """A colour for each sigma; plain gradient descent is dashed."""
    kinds = list(dict.fromkeys(r.partition(", ")[2] for r in recipes))
    palette = (*SERIES, INK)
    return {
        "color": palette[kinds.index(recipe.partition(", ")[2]) % len(palette)],
        "linestyle": "--" if recipe.startswith("gradient") else "-",
        "linewidth": 2.2 if "→" in recipe and "Adam" in recipe else 1.1,
    }


def draw_masses_and_starts(
    summaries: Sequence[Summary], choices: Sequence[Choice], path: Path
) -> Path:
    """Heavy and light points over iterations; pose error over the number of starts."""
    chosen = [s for s in summaries if s.study == "masses"]
    figure = make_figure(12.0, 3.8)
    heavy, light, starts = figure.subplots(1, 3)
    for s, color in zip(chosen, SERIES, strict=False):
        heavy.semilogy(s.iterations, s.first_errors, color=color, label=s.recipe)
        light.semilogy(s.iterations, s.second_errors, color=color)
    scenes = list(dict.fromkeys(c.scene for c in choices))
    for scene, color in zip(scenes, SERIES, strict=False):
        found = [(c.starts, c.median_error) for c in choices if c.scene == scene]
        starts.loglog(*zip(*found, strict=True), "o-", color=color, label=scene)
    counts = sorted({c.starts for c in choices})
    for axes, x_label, y_label in (
        (heavy, "iteration", "distance ×100, heaviest third"),
        (light, "iteration", "distance ×100, lightest third"),
        (starts, "K starts from random rotations", "median pose error of the best, °"),
    ):
        label_axes(axes, x_label=x_label, y_label=y_label, grid="both")
    set_ticks(starts, counts)
    heavy.legend(**_LEGEND)
    starts.legend(**_LEGEND)
    return save_figure(figure, path)
