"""The benchmark's figures, drawn without a display."""

import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from dpc_jax.files import write_bytes
from dpc_jax.measure.benchmark.accuracy import SOON

_COLORS = (
    *("#2f7ebc", "#3a9d6e", "#d1495b", "#e0a030"),
    *("#7b5ea7", "#5f6c77", "#56b4c9", "#8c5a3c"),
)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_INK, _MUTED = "#22303c", "#8795a1"
_FLOOR = 1e-8  # smaller errors are drawn here


def draw_errors(
    records: list[dict], path: Path, *, kind: str, suffix: str = ""
) -> Path:
    """Error against run time, a panel per scene; colour by setting, marker by sigma.

    Args:
      records: of `accuracy.measure_scene`. path: of the PNG.
      kind: "image" or "gradient". suffix: "" or "_same_grid".
    """
    scenes = list(dict.fromkeys(r["scene"] for r in records))
    families = list(dict.fromkeys(r["family"] for r in records))
    sigmas = sorted({r["sigma"] for r in records})
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    panels = figure.subplots(2, -(-len(scenes) // 2), sharex=True, sharey=True)
    flat = np.atleast_1d(panels).ravel()
    for axes, scene in zip(flat, scenes, strict=False):
        for family, color in zip(families, _COLORS, strict=False):
            for sigma, marker in zip(sigmas, _MARKERS, strict=False):
                chosen = [
                    r
                    for r in records
                    if (r["scene"], r["family"], r["sigma"]) == (scene, family, sigma)
                ]
                seconds = [1e3 * r[f"{kind}_seconds"] for r in chosen]
                errors = [max(r[f"{kind}_error{suffix}"], _FLOOR) for r in chosen]
                # Settings that differ in one number: from cheap to dear.
                order = np.argsort(seconds)
                axes.plot(
                    np.array(seconds)[order],
                    np.array(errors)[order],
                    marker=marker,
                    color=color,
                    linewidth=0.6,
                    markersize=5,
                    alpha=0.8,
                )
        axes.axhline(SOON, color=_INK, linestyle="--", linewidth=0.8)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())  # they would overlap
        axes.set_title(scene, fontsize=10, color=_INK)
        axes.grid(which="major", color="#e3e7ea", linewidth=0.6)
    for axes in flat[len(scenes) :]:
        axes.set_visible(False)
    passes = "forward" if kind == "image" else "forward and backward"
    truth = "exact, same grid" if suffix else "float64 on a finer grid"
    figure.supxlabel(f"run time of {passes}, ms", fontsize=10)
    figure.supylabel(f"relative error of the {kind} ({truth})", fontsize=10)
    keys = [
        Line2D([], [], color=color, linewidth=2, label=family)
        for family, color in zip(families, _COLORS, strict=False)
    ]
    keys += [
        Line2D([], [], color=_MUTED, marker=m, linestyle="", label=f"σ = {s:g} voxels")
        for s, m in zip(sigmas, _MARKERS, strict=False)
    ]
    keys.append(Line2D([], [], color=_INK, linestyle="--", label=f"{SOON:.0%}"))
    figure.legend(handles=keys, loc="outside right center", fontsize=8, frameon=False)
    return _save(figure, path)


def draw_scaling(results: list[dict], path: Path) -> Path:
    """A panel per number, with its expected order dashed through the largest value."""
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    flat = figure.subplots(2, 2).ravel()
    for axes, result in zip(flat, results, strict=False):
        values = np.array(result["values"], float)
        times = 1e3 * np.array(result["median_seconds"])
        order = result["order"]
        name = result["axis"] if order == 1 else f"{result['axis']}$^{order}$"
        expected = times[-1] * (values / values[-1]) ** order
        axes.loglog(values, times, "o-", color=_COLORS[0], label="measured")
        axes.loglog(
            values, expected, "--", color=_MUTED, label=f"proportional to {name}"
        )
        axes.set_xlabel(f"{result['axis']}, {result['subject']}", fontsize=9)
        axes.set_ylabel("ms", fontsize=9)
        axes.set_xticks(values, [f"{v:g}" for v in values])
        axes.set_xticks([], minor=True)
        axes.grid(which="major", color="#e3e7ea", linewidth=0.6)
        axes.legend(fontsize=8, frameon=False)
    for axes in flat[len(results) :]:
        axes.set_visible(False)
    figure.suptitle(
        f"Run time of forward and backward; else {results[0]['base']}", fontsize=10
    )
    return _save(figure, path)


def _save(figure, path):
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    return write_bytes(path, buffer.getvalue())
