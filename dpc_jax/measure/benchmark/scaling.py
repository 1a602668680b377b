"""How run time grows with the number of points, cells, samples and candidates."""

import dataclasses
from typing import Any

import numpy as np

from dpc_jax.measure.benchmark import speed
from dpc_jax.measure.benchmark.plan import Plan
from dpc_jax.measure.timing import take_medians, time_interleaved

# Axis: what it counts, and the power of it that the run time is expected to follow
# once it dominates. A grid has D³ cells; dense smoothing, of wide kernels, takes D⁴.
AXES = {
    "N": ("points", 1),
    "D": ("cells a side", 3),
    "B": ("samples", 1),
    "K": ("candidates, the winner with a gradient", 1),
}


def measure_axis(axis: str, *, plan: Plan) -> dict[str, Any]:
    """Median seconds, forward and backward, for each value of one number.

    Args:
      axis: of `AXES`; the other numbers are those of the plan's base case.
    """
    base = plan.scaling_base
    values = {
        "N": plan.scaling_points,
        "D": plan.scaling_sides,
        "B": plan.scaling_batches,
        "K": plan.scaling_candidates,
    }[axis]
    calls = {}
    for value in values:
        if axis == "K":
            calls[value] = _prepare_choice(base, value, seed=plan.seed)
        else:
            field = {"N": "points", "D": "side", "B": "batch"}[axis]
            case = dataclasses.replace(base, **{field: value})
            calls[value] = _prepare_render(case, seed=plan.seed)
    seconds = time_interleaved(calls, rounds=plan.rounds)
    medians = take_medians(seconds)
    subject, order = AXES[axis]
    return {
        "axis": axis,
        "subject": subject,
        "order": order,
        "base": str(base),
        "values": list(values),
        "median_seconds": [medians[value] for value in values],
        "seconds": [seconds[value] for value in values],
    }


def _prepare_render(case, *, seed):
    work = speed.draw_work(case, seed=seed)
    return speed.make_jax_call(speed.render_ours, *work, case.sigma, side=case.side)


def _prepare_choice(case, num_candidates, *, seed):
    points, _, masses, targets = speed.draw_work(case, seed=seed)
    rng = np.random.default_rng([seed, 1])
    candidates = rng.normal(size=(case.batch, num_candidates, 4))
    candidates = candidates.astype("f4")
    return speed.make_choice_call(
        "chosen", points, candidates, masses, targets, case.sigma
    )
