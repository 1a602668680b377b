"""benchmark.md, benchmark.json and figures: the records, in whole sentences."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from dpc_jax.evaluation.metrics import MISSING
from dpc_jax.files import write_json, write_text
from dpc_jax.measure.benchmark import accuracy
from dpc_jax.measure.timing import phrase_machine
from dpc_jax.reporting import style
from dpc_jax.reporting.tables import format_table

_KINDS = {"image": "forward", "gradient": "forward and backward"}
_SHOWN = 3  # sigmas in the figure of errors


def write_report(out: Path, results: dict[str, Any]) -> Path:
    """Write the figures, benchmark.json and benchmark.md; returns the last."""
    machine = results["machine"]
    blocks = [
        "# Error against run time",
        f"{phrase_machine(machine)}; seed {results['seed']}; load "
        f"{machine['load_at_start']:.1f} at the start.",
        "All times are medians of rounds in which the compared calls take turns. With "
        "glibc, the process keeps freed memory for the next call, for all peers alike "
        "(`dpc_jax.run.process`); otherwise page faults would be much of what is "
        "measured.",
        f"To repeat: `{results['command']}`",
    ]
    for part, write in _SECTIONS.items():
        if results.get(part):
            blocks += write(out, results)
    write_json(out / "benchmark.json", results)
    page = "\n\n".join(block.strip("\n") for block in blocks) + "\n"
    return write_text(out / "benchmark.md", page)


def _write_speed(out, results) -> list[str]:
    intro = "Silhouette, forward and backward, float32."
    if not results["has_torch"]:
        intro += " PyTorch is not installed and was left out; "
        intro += "`pip install '.[bench]'` adds it."
    rows = []
    for result in results["speed"]:
        for name, seconds in result["median_seconds"].items():
            differences = result["gradient_difference"].get(name)
            agreement = f"{max(differences):.1e}" if differences else MISSING
            rows.append((result["case"], name, _ms(seconds), agreement))
    count = results["machine"]["devices"]
    heads = ("work", "call", "ms", "gradient")
    return [
        "## Speed",
        intro,
        format_table(heads, rows),
        "*gradient*: largest relative L2 difference among the gradients from the first "
        "call of the same work. "
        f"`project_batch` on {count} device{'s' * (count != 1)}; *PyTorch* does a "
        "batch at once.",
    ]


def _write_sizes(out, results) -> list[str]:
    rows = []
    for result in results["sizes"]:
        seconds, sizes = result["median_seconds"], result["bytes"]
        numbers = [
            f"{scale * values[name]:.3g}" if name in values else MISSING
            for values, scale, name in (
                *((seconds, 1e3, "whole"), (seconds, 1e3, "blocks")),
                *((sizes, 1e-9, "whole"), (sizes, 1e-9, "blocks")),
                (seconds, 1e3, "PyTorch"),
            )
        ]
        signals, share = ", ".join(result["signals"]), _percent(result["share"])
        rows.append([result["case"], signals, share, *numbers])
    heads = ["work", "signals", "blocks touched", "whole volume (ms)", "blocks (ms)"]
    heads += ["whole volume (GB)", "blocks (GB)", "PyTorch, whole volume (ms)"]
    return [
        "## How large",
        "A car's surface, forward and backward, float32: in the whole volume, and in "
        "room for a fifth more blocks of 8³ cells than it touches (`max_blocks`). "
        "Memory is that of `dpc_jax.estimate_memory`.",
        format_table(heads, rows),
    ]


def _write_error(out, results) -> list[str]:
    records = accuracy.take_scenes_together(results["error"])
    fine = f"{results['reference_side']}³"
    draw_errors(records, out / "error.png")
    return [
        "## Error",
        f"Relative L2 errors against the gaussian method in float64 on {fine} cells, "
        "for the image (in blocks of the coarsest grid's pixels) and for the gradient "
        "to the points of its squared difference from another pose's image: medians "
        f"over four scenes. σ is in voxels of {results['base_side']}³. Times are for "
        "one sample.",
        "![Error against run time](error.png)",
        "Medians over all σ (largest in brackets):",
        _tabulate_settings(records),
    ]


def _tabulate_settings(records) -> str:
    rows = []
    for setting in dict.fromkeys(r["setting"] for r in records):
        group = [r for r in records if r["setting"] == setting]
        cells = [setting]
        for kind in _KINDS:
            values = [r[f"{kind}_error"] for r in group]
            cells.append(f"{_percent(np.median(values))} ({_percent(max(values))})")
            cells.append(_ms(np.median([r[f"{kind}_seconds"] for r in group])))
        rows.append(cells)
    heads = [head for k in _KINDS for head in (f"{k} error", "ms")]
    return format_table(["setting", *heads], rows)


def draw_errors(records: Sequence[dict[str, Any]], path: Path) -> Path:
    """Error against run time: a row for image and gradient, a column for each sigma.

    A curve joins settings that differ in one number. Records are those of
    `accuracy.take_scenes_together`.
    """
    families = list(dict.fromkeys(r["family"] for r in records))
    sigmas = sorted({r["sigma"] for r in records})
    middle = len(sigmas) // 2
    sigmas = sigmas[max(0, middle - _SHOWN // 2) :][:_SHOWN]
    figure = style.make_figure(4.0 * len(sigmas), 6.6)
    panels = figure.subplots(len(_KINDS), len(sigmas), squeeze=False, sharey="row")
    for row, (kind, passes) in zip(panels, _KINDS.items(), strict=True):
        for axes, sigma in zip(row, sigmas, strict=True):
            for number, family in enumerate(families):
                chosen = [
                    (1e3 * r[f"{kind}_seconds"], r[f"{kind}_error"])
                    for r in records
                    if (r["family"], r["sigma"]) == (family, sigma)
                ]
                look = style.pick_series(number) | {"lw": 1.2, "ms": 4}
                axes.plot(*zip(*sorted(chosen), strict=True), label=family, **look)
            axes.axhline(0.01, color=style.MUTED, ls="--", lw=0.8)
            axes.set(xscale="log", yscale="log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())  # they would overlap
            title = f"{kind}, σ = {sigma:g} voxels"
            style.label_axes(axes, title=title, x_label=f"{passes} (ms)", grid="both")
        row[0].set_ylabel("relative error", fontsize=9)
    handles, _ = panels[0, 0].get_legend_handles_labels()
    style.add_legend(figure, handles=handles, ncols=3)
    return style.save_figure(figure, path)


_SECTIONS = {"speed": _write_speed, "sizes": _write_sizes, "error": _write_error}


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2f}"


def _percent(value: float) -> str:
    return f"{100 * value:.2g} %"
