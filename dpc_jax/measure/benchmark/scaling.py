"""How run time grows with the number of points, cells, samples and candidates."""

import dataclasses
from typing import Any

from dpc_jax.measure.benchmark import speed
from dpc_jax.measure.benchmark.plan import Plan
from dpc_jax.measure.timing import take_medians, time_interleaved

# Axis: what it counts, and the power of it that the run time is expected to follow
# once it dominates. A grid has D³ cells; smoothing by wide, dense kernels takes D⁴.
AXES = {
    "N": ("points", 1),
    "D": ("cells a side", 3),
    "B": ("samples", 1),
    "K": ("candidates, the winner with a gradient", 1),
}


def measure_axis(axis: str, *, plan: Plan) -> dict[str, Any]:
    """Median seconds, forward and backward, for each value of one number of `AXES`.

    The other numbers are those of the plan's base case.
    """
    base, seed = plan.scaling_base, plan.seed
    subject, order = AXES[axis]
    if axis == "K":
        values = plan.scaling_candidates
        works = [speed.draw_candidates(base, value, seed=seed) for value in values]
        calls = [speed.make_choice_call("chosen", work, base.sigma) for work in works]
    else:
        field, values = {
            "N": ("points", plan.scaling_points),
            "D": ("side", plan.scaling_sides),
            "B": ("batch", plan.scaling_batches),
        }[axis]
        cases = [dataclasses.replace(base, **{field: value}) for value in values]
        calls = [speed.prepare_render(case, seed=seed) for case in cases]
    names = [str(value) for value in values]
    seconds = time_interleaved(dict(zip(names, calls, strict=True)), rounds=plan.rounds)
    medians = take_medians(seconds)
    return {
        "axis": axis,
        "subject": subject,
        "order": order,
        "base": str(base),
        "values": list(values),
        "median_seconds": [medians[name] for name in names],
        "seconds": [seconds[name] for name in names],
    }
