"""What the report shows of many descents: medians over seeds, and the best of K."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dpc_jax.measure.stability.stiff.studies import EVERY, Run


class Summary(NamedTuple):
    """Medians over seeds of one recipe on one scene; names as in `Run`."""

    study: str
    scene: str
    recipe: str
    # Of plain gradient descent, the one with the lowest final loss; or None
    rate: float | None
    seconds: float  # of the whole descent
    iterations: list[int]  # [n] at which errors were measured
    losses: list[float]  # [n] mean over views
    # [n]. In "shape" the pose error in degrees and the Chamfer distance ×100; in
    # "masses" the root mean square distance ×100 of the heaviest and of the lightest
    # third of the points from their true places.
    first_errors: list[float]
    second_errors: list[float]


class Choice(NamedTuple):
    """Pose errors over all views and seeds, of the best of K starts by its loss."""

    scene: str
    starts: int  # K
    median_error: float  # degrees
    accuracy: float  # share of views within 30°
    seconds: float  # of all K descents of one view set


def summarize(runs: Sequence[Run]) -> list[Summary]:
    """Medians over seeds; of plain gradient descent the rate with the lowest loss."""
    groups: dict[tuple, list[Run]] = {}
    for r in runs:
        if r.study != "starts":
            groups.setdefault((r.study, r.scene, r.recipe, r.rate), []).append(r)
    best: dict[tuple, Summary] = {}
    for (study, scene, recipe, rate), found in groups.items():
        errors = zip(*map(_measure_errors, found), strict=True)
        losses, first, second = (np.median(e, axis=0).tolist() for e in errors)
        seconds = float(np.median([r.seconds for r in found]))
        iterations = [EVERY * i for i in range(len(losses))]
        summary = Summary(
            *(study, scene, recipe, rate), seconds, iterations, losses, first, second
        )
        other = best.get((study, scene, recipe))
        if other is None or losses[-1] < other.losses[-1]:
            best[study, scene, recipe] = summary
    return list(best.values())


def _measure_errors(run):
    """Loss and both errors of a run over its iterations."""
    trace, losses = run.trace, np.mean(run.trace.losses, axis=1)
    if run.study == "shape":
        return losses, np.median(trace.pose_errors[:, 1:], axis=1), trace.chamfer
    third = trace.distances.shape[1] // 3
    squares = trace.distances.astype(np.float64) ** 2
    heavy, light = (
        100 * np.sqrt(np.mean(part, axis=1))
        for part in (squares[:, :third], squares[:, -third:])
    )
    return losses, heavy, light


def choose_starts(runs: Sequence[Run]) -> list[Choice]:
    """For K = 1, 2, 4, ...: the first K starts, of which each view keeps the best."""
    by_scene: dict[str, dict[int, list[Run]]] = {}
    for r in runs:
        if r.study == "starts":
            by_scene.setdefault(r.scene, {}).setdefault(r.seed, []).append(r)
    choices = []
    for scene, by_seed in by_scene.items():
        most = min(len(found) for found in by_seed.values())
        for count in (2**i for i in range(most.bit_length())):
            errors, seconds = [], []
            for found in by_seed.values():
                losses = np.array([r.trace.losses[-1] for r in found[:count]])
                angles = np.array([r.trace.pose_errors[-1] for r in found[:count]])
                errors.append(angles[np.argmin(losses, axis=0), range(angles.shape[1])])
                seconds.append(sum(r.seconds for r in found[:count]))
            accuracy = float(np.mean(np.array(errors) < 30))
            median, time = float(np.median(errors)), float(np.median(seconds))
            choices.append(Choice(scene, count, median, accuracy, time))
    return choices
