"""The parts of the benchmark: what they measure."""

import itertools
from collections.abc import Callable
from functools import partial

from dpc_jax.measure import scenes
from dpc_jax.measure.benchmark import accuracy, speed
from dpc_jax.measure.benchmark.plan import SEED, Plan

# What is measured, and the call that gives its record, or several.
Task = tuple[str, Callable[[], dict | list[dict]]]


def list_tasks(part: str, plan: Plan) -> list[Task]:
    """What a part of a plan measures."""
    turns = {"rounds": plan.rounds}
    if part == "speed":
        peers = speed.compare_with_peers
        tasks = [(str(case), partial(peers, case, **turns)) for case in plan.cases]
        sizes = partial(speed.compare_sizes, plan.sized, **turns)
        return [*tasks, ("a sigma per point", sizes)]
    if part == "sizes":
        return [
            (
                f"{'+'.join(signals)}, {case}",
                partial(speed.compare_volumes, case, signals, **turns),
            )
            for case, signals in plan.sizes
        ]
    made = scenes.make_scenes(
        num_points=plan.scene_points, num_sparse=plan.sparse_points, seed=SEED
    )
    settings = [
        accuracy.Setting(*family, side)
        for side in plan.sides
        for family in accuracy.FAMILIES
    ]
    fixed = {"plan": plan, "settings": settings}
    return [
        (
            f"{scene.name}, σ={sigma:g}",
            partial(accuracy.measure_scene, scene, sigma, **fixed),
        )
        for scene, sigma in itertools.product(made, plan.sigmas)
    ]
