"""The benchmark's figures."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from dpc_jax.measure.benchmark.accuracy import SOON
from dpc_jax.reporting import style

_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_FLOOR = 1e-8  # smaller errors are drawn here


def draw_errors(
    records: list[dict[str, Any]], path: Path, *, kind: str, suffix: str = ""
) -> Path:
    """Error against run time, a panel per scene; colour by setting, marker by sigma.

    Kind and suffix are those of `accuracy.find_soonest`.
    """
    families = dict.fromkeys(r["family"] for r in records)
    colors = dict(zip(families, style.SERIES, strict=False))
    markers = dict(zip(sorted({r["sigma"] for r in records}), _MARKERS, strict=False))
    scenes = list(dict.fromkeys(r["scene"] for r in records))
    figure = style.make_figure(11.0, 8.0)
    panels = style.make_panels(figure, len(scenes), share=True)
    for axes, scene in zip(panels, scenes, strict=True):
        for family, color in colors.items():
            for sigma, marker in markers.items():
                error = f"{kind}_error{suffix}"
                chosen = [
                    (1e3 * r[f"{kind}_seconds"], max(r[error], _FLOOR))
                    for r in records
                    if (r["scene"], r["family"], r["sigma"]) == (scene, family, sigma)
                ]
                look = {"color": color, "marker": marker, "lw": 0.6, "ms": 5}
                # Settings that differ in one number, the cheapest first.
                axes.plot(*zip(*sorted(chosen), strict=True), alpha=0.8, **look)
        axes.axhline(SOON, color=style.INK, linestyle="--", linewidth=0.8)
        axes.set(xscale="log", yscale="log")
        axes.xaxis.set_minor_formatter(NullFormatter())  # they would overlap
        style.label_axes(axes, title=scene, grid="both")
    passes = "forward" if kind == "image" else "forward and backward"
    truth = "exact, same grid" if suffix else "float64 on a finer grid"
    figure.supxlabel(f"run time of {passes} (ms)", fontsize=10)
    figure.supylabel(f"relative error of the {kind} ({truth})", fontsize=10)
    keys = [Line2D([], [], color=c, lw=2, label=family) for family, c in colors.items()]
    keys += [
        Line2D([], [], color=style.MUTED, marker=m, ls="", label=f"σ = {s:g} voxels")
        for s, m in markers.items()
    ]
    keys.append(Line2D([], [], color=style.INK, ls="--", label=f"{SOON:.0%}"))
    figure.legend(handles=keys, loc="outside right center", fontsize=8, frameon=False)
    return style.save_figure(figure, path)


def draw_solids(records: list[dict[str, Any]], path: Path) -> Path:
    """Error of the silhouette against run time: a line of volumes, clouds alone."""
    figure = style.make_figure(9.0, 4.0)
    panels = style.make_panels(figure, 2, share=True)
    kinds = {"image": "forward", "gradient": "forward and backward"}
    for axes, (kind, title) in zip(panels, kinds.items(), strict=True):
        # Two numbers of a cloud differ from one to the next: no line joins them.
        looks = zip(("volume", "points"), ("o-", "s"), style.SERIES, strict=False)
        for family, look, color in looks:
            chosen = [r for r in records if r["family"] == family]
            times = [1e3 * r[f"{kind}_seconds"] for r in chosen]
            errors = [100 * r["image_error"] for r in chosen]
            axes.plot(times, errors, look, color=color, label=family, lw=0.8)
            for x, y, record in zip(times, errors, chosen, strict=True):
                label = record["setting"].removeprefix("volume, ")
                axes.annotate(
                    label.replace(" points", ""),
                    (x, y),
                    textcoords="offset points",
                    xytext=(5, 4) if family == "points" else (-20, -10),
                    fontsize=7,
                    color=color,
                )
        axes.set(xscale="log", yscale="log")
        axes.margins(x=0.2, y=0.15)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        style.label_axes(axes, title=title, x_label="ms", grid="both")
    panels[0].legend(fontsize=8, frameon=False)
    figure.supylabel("error of the silhouette (%)", fontsize=10)
    return style.save_figure(figure, path)


def draw_scaling(results: list[dict[str, Any]], path: Path) -> Path:
    """A panel per number, with its expected order dashed through the largest value."""
    figure = style.make_figure(9.0, 6.5)
    panels = style.make_panels(figure, len(results))
    for axes, result in zip(panels, results, strict=True):
        values = np.array(result["values"], float)
        times = 1e3 * np.array(result["median_seconds"])
        order, name = result["order"], result["axis"]
        power = name if order == 1 else f"{name}$^{order}$"
        expected = times[-1] * (values / values[-1]) ** order
        axes.loglog(values, times, "o-", color=style.SERIES[0], label="measured")
        label = f"proportional to {power}"
        axes.loglog(values, expected, "--", color=style.MUTED, label=label)
        label = f"{name}, {result['subject']}"
        style.label_axes(axes, x_label=label, y_label="ms", grid="both")
        style.set_ticks(axes, values)
        axes.legend(fontsize=8, frameon=False)
    title = "Run time of forward and backward; all other numbers as in "
    figure.suptitle(title + results[0]["base"], fontsize=10)
    return style.save_figure(figure, path)
