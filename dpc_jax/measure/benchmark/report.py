"""benchmark.md and benchmark.json: the records as tables, in whole sentences."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.evaluation.metrics import MISSING
from dpc_jax.files import write_json, write_text
from dpc_jax.measure.benchmark import accuracy, figures
from dpc_jax.measure.timing import phrase_machine
from dpc_jax.reporting.tables import format_table

_KINDS = ("image", "gradient")
# What errors are measured against, by the suffix of their names in the records.
_REFERENCES = {
    "": "the reference on {}",
    "_same_grid": "the exact result on the same grid",
}
# Times of the released TensorFlow code over those of `plain_peer`, measured side by
# side on another day (B, N, D, σ): it needs libraries of its own and is not run here.
_RELEASED = {
    "B=16, N=8000, D=64, σ=3": 250 / 22,
    "B=16, N=2000, D=32, σ=1.6": 33 / 4,
    "B=4, N=16000, D=128, σ=3": 391 / 47,
}


def write_report(out: Path, results: dict[str, Any]) -> Path:
    """Write the figures, benchmark.json and benchmark.md; returns the last."""
    load = results["machine"]["load_at_start"]
    load = "" if load is None else f"; load {load:.1f} at the start"
    blocks = [
        "# Error against run time",
        f"{phrase_machine(results['machine'])}; seed {results['seed']}{load}.",
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
        medians, ours = result["median_seconds"], result["ours"]
        own = [result["case"], f"{ours} {1e3 * medians[ours]:.2f}"]
        for peer, ratio in result["ratio_to_ours"].items():
            differences = result["gradient_difference"].get(peer)
            agreement = f"{max(differences):.1e}" if differences else MISSING
            peer_ms = f"{1e3 * medians[peer]:.2f}"
            rows.append([*own, peer, peer_ms, f"{ratio:.2f}", agreement])
        factor = _RELEASED.get(result["case"])
        if factor and "plain JAX" in medians:
            inferred = factor * medians["plain JAX"]
            times = [f"{1e3 * inferred:.0f}", f"{inferred / medians[ours]:.1f}"]
            rows.append([*own, "released code, inferred", *times, MISSING])
    count = results["machine"]["devices"]
    devices = f"{count} device" + "s" * (count != 1)
    heads = ["work", "ours (ms)", "peer", "peer (ms)", "peer / ours", "gradient"]
    return [
        "## Speed",
        intro,
        format_table(heads, rows, align="lrlrrr"),
        "*gradient*: largest relative L2 difference from ours among the gradients. "
        f"*All devices*: `project_batch` on {devices}; *one device* has all of XLA's "
        "threads. "
        "*Plain JAX* writes the same steps without the engine; *PyTorch* does a batch "
        "at once. *Inferred*: plain JAX's time, times what the released code took "
        "beside it (250:22, 33:4, 391:47). *trilinear* and *gaussian*: one σ for all "
        "points, and one each (0.5 to 1.5 times that). *chosen*: the best of K "
        "candidates found without a gradient, then rendered with one; *min*: the "
        "minimum over K renders with a gradient.",
    ]


def _write_error(out, results) -> list[str]:
    records = results["error"]
    fine = f"{results['reference_side']}³"
    variants = [(kind, suffix) for kind in _KINDS for suffix in _REFERENCES]
    blocks = [
        "## Error",
        f"Relative L2 errors against the gaussian method in float64 on {fine} cells, "
        "for the image (in blocks of the coarsest grid's pixels) and for the gradient "
        "to the points of its squared difference from another pose's image. σ is in "
        f"voxels of {results['base_side']}³. *Same grid*: against the exact result on "
        "the setting's own grid, which leaves the method's own error. Times are for "
        "one sample.",
    ]
    for kind, suffix in variants:
        name = f"error_{kind}{suffix}.png"
        figures.draw_errors(records, out / name, kind=kind, suffix=suffix)
        blocks.append(f"![Error of the {kind} against run time]({name})")
    blocks += [
        "Medians over all scenes and σ (largest in brackets):",
        _tabulate_settings(records),
    ]
    for kind, suffix in variants:
        blocks += [
            f"Fastest setting with at most {accuracy.SOON:.0%} error of the {kind}, "
            f"against {_REFERENCES[suffix].format(fine)}; in brackets the most "
            "accurate, where none is accurate enough:",
            _tabulate_soonest(records, kind, suffix),
        ]
    return blocks


def _tabulate_settings(records) -> str:
    rows = []
    for setting in dict.fromkeys(r["setting"] for r in records):
        group = [r for r in records if r["setting"] == setting]
        cells = [setting]
        for kind in _KINDS:
            for suffix in _REFERENCES:
                values = [r[f"{kind}_error{suffix}"] for r in group]
                cells.append(f"{_percent(np.median(values))} ({_percent(max(values))})")
            seconds = [r[f"{kind}_seconds"] for r in group]
            cells.append(f"{1e3 * np.median(seconds):.2f}")
        rows.append(cells)
    heads = [head for k in _KINDS for head in (f"{k} error", "same grid", "ms")]
    return format_table(["setting", *heads], rows)


def _tabulate_soonest(records, kind, suffix) -> str:
    rows: dict[str, list[str]] = {}
    soonest = accuracy.find_soonest(records, kind=kind, suffix=suffix)
    sigmas = sorted({r["sigma"] for r in soonest})
    for row in sorted(soonest, key=lambda row: row["sigma"]):
        error, ms = _percent(row["error"]), f"{1e3 * row['seconds']:.2f} ms"
        cell = f"{row['setting']}: {error}, {ms}"
        cells = rows.setdefault(row["scene"], [row["scene"]])
        cells.append(cell if row["reached"] else f"({cell})")
    heads = ["scene", *(f"σ = {sigma:g}" for sigma in sigmas)]
    return format_table(heads, rows.values(), align="l" * len(heads))


def _write_solids(out, results) -> list[str]:
    figures.draw_solids(results["solids"], out / "solids.png")
    rows = []
    for r in results["solids"]:
        times = [f"{1e3 * r[f'{kind}_seconds']:.2f}" for kind in _KINDS]
        size = r["temporary_bytes"]
        megabytes = MISSING if size is None else f"{size / 1e6:.1f}"
        rows.append([r["setting"], _percent(r["image_error"]), *times, megabytes])
    return [
        "## Volumes beside point clouds",
        "The silhouette of an ellipsoid, which is known in closed form: mean absolute "
        "error in blocks of the coarsest grid's pixels, over the mean of the exact "
        "image. Cells hold the share that is inside; points are drawn inside at "
        "random, half as wide as the space that each has. Both draw it too large: at "
        "the rim, occupancies of a part of a cell add up along a ray. Gradients are "
        "those of the rotation and of cells, or of points and mass. *Temporary*: what "
        "the compiled gradient allocates.",
        "![Error of the silhouette against run time](solids.png)",
        format_table(
            ["what", "error", "image (ms)", "with gradient (ms)", "temporary (MB)"],
            rows,
        ),
    ]


def _write_scaling(out, results) -> list[str]:
    figures.draw_scaling(results["scaling"], out / "scaling.png")
    rows = []
    for result in results["scaling"]:
        name, order = result["axis"], result["order"]
        pairs = zip(result["values"], result["median_seconds"], strict=True)
        times = ", ".join(f"{value}: {1e3 * time:.2f}" for value, time in pairs)
        power = name if order == 1 else f"{name}^{order}"
        rows.append([f"{name}, {result['subject']}", power, times])
    return [
        "## Growth",
        "![Run time against N, D, B and K](scaling.png)",
        format_table(["number", "expected", "run time (ms)"], rows, align="lll"),
        f"All other numbers are those of {results['scaling'][0]['base']}. The dashed "
        "line is the expected order, through the largest value. Times above it at "
        "small values show a part that does not grow, such as the volume's smoothing "
        "where there are few points.",
    ]


def _write_memory(out, results) -> list[str]:
    specs = {"extra": ".2f", "limit": ".1f", "estimate": ".3f", "all_cells": ".4g"}
    rows = []
    for result in results["memory"]:
        sizes = [(result[f"{name}_bytes"], spec) for name, spec in specs.items()]
        cells = [MISSING if n is None else format(n / 1e9, spec) for n, spec in sizes]
        rows.append([result["method"], result["case"], *cells])
    heads = ["method", "work", "extra peak (GB)", "limit (GB)", "estimate (GB)"]
    return [
        "## Memory",
        "Peak of a whole process that runs forward and backward, samples one after the "
        "other, less that of one that only imports JAX. It includes code and compiler; "
        "the estimate, that of `dpc_jax.estimate_memory` for one sample, does not.",
        format_table([*heads, "N·D³ floats (GB)"], rows, align="llrrrr"),
    ]


_SECTIONS = {
    "speed": _write_speed,
    "error": _write_error,
    "solids": _write_solids,
    "scaling": _write_scaling,
    "memory": _write_memory,
}


def _percent(value: float) -> str:
    return f"{100 * value:.2g} %" if math.isfinite(value) else MISSING
