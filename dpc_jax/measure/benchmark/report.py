"""benchmark.md and benchmark.json: the records as tables, in whole sentences."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.files import write_json, write_text
from dpc_jax.measure.benchmark import accuracy, figures

# Times of the released TensorFlow code over those of `plain_peer`, measured side by
# side on another day (B, N, D, σ): it needs libraries of its own and is not run here.
_RELEASED = {
    "B=16, N=8000, D=64, σ=3": 250 / 22,
    "B=16, N=2000, D=32, σ=1.6": 33 / 4,
    "B=4, N=16000, D=128, σ=3": 391 / 47,
}


def write_report(out: Path, results: dict[str, Any]) -> Path:
    """Write the figures, benchmark.json and benchmark.md of a run.

    Args:
      out: folder. results: of `suite.run_benchmark`.
    """
    text = [
        _describe_run(results),
        *(
            write(out, results)
            for part, write in _SECTIONS.items()
            if results.get(part)
        ),
    ]
    write_json(out / "benchmark.json", results)
    return write_text(out / "benchmark.md", "\n".join(text))


def _describe_run(results):
    machine = results["machine"]
    flags = ", ".join(machine["flags"]) or "no flags of note"
    load = machine["load_at_start"]
    lines = [
        "# Error against run time",
        "",
        f"{machine['processor']} ({flags}), {machine['cores']} of its cores, "
        f"{machine['system']}; JAX {machine['jax']} on {machine['backend']}, Python "
        f"{machine['python']}; seed {results['seed']}"
        + ("" if load is None else f"; load {load:.1f} at the start")
        + ".",
        "",
        "All times are medians of rounds in which the things compared take turns. With "
        "glibc, the process keeps freed memory for the next call, for all peers alike "
        "(`dpc_jax.process`): else page faults would be much of what is measured.",
    ]
    if results.get("command"):
        lines += ["", f"Again: `{results['command']}`"]
    return "\n".join(lines) + "\n"


def _write_speed(out, results):
    lines = ["## Speed", "", "Silhouette, forward and backward, float32."]
    if not results["has_torch"]:
        lines[-1] += (
            " PyTorch is not installed and was left out; "
            "`pip install '.[bench]'` adds it."
        )
    lines += ["", "| work | ours (ms) | peer | peer (ms) | peer / ours | gradient |"]
    lines.append("|---|---:|---|---:|---:|---:|")
    for result in results["speed"]:
        medians = result["median_seconds"]
        own = 1e3 * medians[result["ours"]]
        for peer, ratio in result["ratio_to_ours"].items():
            differences = result["gradient_difference"].get(peer)
            agreement = f"{max(differences):.1e}" if differences else "–"
            lines.append(
                f"| {result['case']} | {result['ours']} {own:.2f} | {peer} | "
                f"{1e3 * medians[peer]:.2f} | {ratio:.2f} | {agreement} |"
            )
        factor = _RELEASED.get(result["case"])
        if factor and "plain JAX" in medians:
            ratio = factor * medians["plain JAX"] / medians[result["ours"]]
            lines.append(
                f"| {result['case']} | {result['ours']} {own:.2f} | released code, "
                f"inferred | {1e3 * factor * medians['plain JAX']:.0f} | {ratio:.1f} "
                "| – |"
            )
    lines += [
        "",
        "*gradient*: largest relative L2 difference from ours among the gradients. "
        "*Plain JAX* writes the same steps without the engine; *PyTorch* does a batch "
        "at once. *Inferred*: plain JAX's time, times what the released code took "
        "beside it (250:22, 33:4, 391:47). *trilinear* and *gaussian*: one σ for all "
        "points, and one each (0.5 to 1.5 times that). *chosen*: the best of K "
        "candidates found without a gradient, then rendered with one; *min*: the "
        "minimum over K renders with a gradient.",
    ]
    return "\n".join(lines) + "\n"


def _write_error(out, results):
    records = results["error"]
    lines = [
        "## Error",
        "",
        f"Relative L2 errors against the gaussian method in float64 on "
        f"{results['reference_side']}³ cells, for the image (in blocks of the coarsest "
        "grid's pixels) and for the gradient to the points of its squared difference "
        f"from another pose's image. σ is in voxels of {results['base_side']}³. *Same "
        "grid*: against the exact result on the setting's own grid; what is left is "
        "the method's own error. Times are for one sample.",
    ]
    for kind in ("image", "gradient"):
        for suffix in ("", "_same_grid"):
            name = f"error_{kind}{suffix}.png"
            figures.draw_errors(records, out / name, kind=kind, suffix=suffix)
            lines += ["", f"![Error of the {kind} against run time]({name})"]
    lines += ["", "Over all scenes and σ, medians (largest in brackets):", ""]
    lines += _tabulate_settings(records)
    for kind in ("image", "gradient"):
        for suffix, against in (
            ("", f"the reference on {results['reference_side']}³"),
            ("_same_grid", "the exact result on the same grid"),
        ):
            lines += [
                "",
                f"Soonest to {accuracy.SOON:.0%} error of the {kind}, against "
                f"{against}; in brackets the most accurate where none gets there:",
                "",
                *_tabulate_soonest(records, kind, suffix),
            ]
    return "\n".join(lines) + "\n"


def _tabulate_settings(records):
    lines = [
        "| setting | image error | same grid | ms | gradient error | same grid | ms |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for setting in dict.fromkeys(r["setting"] for r in records):
        group = [r for r in records if r["setting"] == setting]
        cells = []
        for kind in ("image", "gradient"):
            for suffix in ("_error", "_error_same_grid"):
                values = [r[kind + suffix] for r in group]
                cells.append(f"{_percent(np.median(values))} ({_percent(max(values))})")
            cells.append(
                f"{1e3 * np.median([r[f'{kind}_seconds'] for r in group]):.2f}"
            )
        lines.append(f"| {setting} | {' | '.join(cells)} |")
    return lines


def _tabulate_soonest(records, kind, suffix):
    rows = accuracy.find_soonest(records, kind=kind, suffix=suffix)
    sigmas = sorted({r["sigma"] for r in rows})
    lines = ["| scene | " + " | ".join(f"σ = {s:g}" for s in sigmas) + " |"]
    lines.append("|---|" + "---|" * len(sigmas))
    for scene in dict.fromkeys(r["scene"] for r in rows):
        cells = []
        for sigma in sigmas:
            row = next(r for r in rows if (r["scene"], r["sigma"]) == (scene, sigma))
            cell = (
                f"{row['setting']}: {_percent(row['error'])}, "
                f"{1e3 * row['seconds']:.2f} ms"
            )
            cells.append(cell if row["reached"] else f"({cell})")
        lines.append(f"| {scene} | {' | '.join(cells)} |")
    return lines


def _write_scaling(out, results):
    figures.draw_scaling(results["scaling"], out / "scaling.png")
    lines = ["## Growth", "", "![Run time against N, D, B and K](scaling.png)", ""]
    lines += ["| number | expected | run time (ms) |", "|---|---|---|"]
    for result in results["scaling"]:
        name = result["axis"]
        power = name if result["order"] == 1 else f"{name}^{result['order']}"
        times = ", ".join(
            f"{value}: {1e3 * seconds:.2f}"
            for value, seconds in zip(
                result["values"], result["median_seconds"], strict=True
            )
        )
        lines.append(f"| {name}, {result['subject']} | {power} | {times} |")
    lines += [
        "",
        f"Else {results['scaling'][0]['base']}. The dashed line is the expected order, "
        "through the largest value: below it a part shows that does not grow, such as "
        "the volume's smoothing where there are few points.",
    ]
    return "\n".join(lines) + "\n"


def _write_memory(out, results):
    lines = [
        "## Memory",
        "",
        "Peak of a whole process that runs forward and backward, samples one after the "
        "other, less that of one that only imports JAX. Code and compiler are in it, "
        "and not in the estimate, which is that of `dpc_jax.estimate_memory` for one "
        "sample.",
        "",
        "| method | work | extra peak (GB) | limit (GB) | estimate (GB) | N·D³ floats "
        "(GB) |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for result in results["memory"]:
        limit = result["limit_bytes"]
        lines.append(
            f"| {result['method']} | {result['case']} | "
            f"{result['extra_bytes'] / 1e9:.2f} | "
            f"{'–' if limit is None else format(limit / 1e9, '.1f')} | "
            f"{result['estimate_bytes'] / 1e9:.3f} | "
            f"{result['all_cells_bytes'] / 1e9:.4g} |"
        )
    return "\n".join(lines) + "\n"


_SECTIONS = {
    "speed": _write_speed,
    "error": _write_error,
    "scaling": _write_scaling,
    "memory": _write_memory,
}


def _percent(value):
    return f"{100 * value:.2g} %" if math.isfinite(value) else "–"
