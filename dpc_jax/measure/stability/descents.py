"""Stiff optimisation: three problems, recipes of descent, and how far each one comes.

Shape: points and poses from six silhouettes of a thin object; points start in a ball,
poses 30° off, and one known pose holds the frame. Masses: points of masses 10⁴ : 1
whose poses are known; a point's curvature grows with the square of its mass, so the
condition number is about 10⁸. Starts: poses alone, of a known shape, from random
rotations, of which each view keeps the one with the lowest loss.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability.case import Row
from dpc_jax.measure.stability.descent import (
    Problem,
    Recipe,
    Trace,
    descend,
    render_views,
    turn_randomly,
)
from dpc_jax.reporting import style
from dpc_jax.reporting.tables import format_table

FIGURE = "stability_descents.png"
VIEWS = 6
EVERY = 10  # iterations between two measurements of the error
BEST, STAGED = "Adam, σ 2 → 0.5", "Adam, heavy points first"
_OFF_DEG = 30.0  # of the first poses from the true ones
_DENSE = 2000  # points that targets are rendered from
_MEMORY = 0.999  # Adam's decay of the mean square
_FEW = 24  # points of the problem of masses
# Final errors of the best recipe on each problem, and the most that they may be.
BOUNDS = {
    # Medians over seeds: a fifth above the worst single seed of the first measurement
    # (6.7°, 7.8), because descents are chaotic and another processor rounds
    # differently. They start at 30° and at 12 to 15.
    "shape": (("pose error (degrees)", 8.0), ("Chamfer distance (x100)", 9.5)),
    # Of the heaviest and lightest third: the worst seed came from 3.6 and 3.0 to 0.0029
    # and 0.94. These are several times the first and half as much again as the second.
    "masses": (
        ("distance of heavy points (x100)", 0.02),
        ("distance of light points (x100)", 1.5),
    ),
}
# Largest share of views that all starts leave more than 30° off. Measured were 0.44 and
# 0.28 of 18 views, uncertain by 0.12 (binomial); a single start leaves five sixths.
LOST_BOUND = 0.6
_WHY = (
    "a bound above the worst seed measured, see dpc_jax/measure/stability/descents.py"
)


@dataclasses.dataclass(frozen=True)
class Plan:
    """How much is run."""

    steps: int = 400  # iterations, a multiple of `EVERY`
    points: int = 600  # to find
    seeds: int = 3  # of views, starts and surfaces
    starts: int = 8  # K
    scenes: tuple[str, ...] = ("car", "chair")  # by name
    sigmas: tuple[float, ...] = (5.0, 2.0, 1.0, 0.5, 0.2)  # fixed ones, in voxels
    # Of plain gradient descent; the best of them is shown
    rates: tuple[float, ...] = (1e-4, 4e-4)


FULL = Plan()
# With as many points as in the problem of masses, one program serves all.
QUICK = Plan(40, _FEW, 1, 2, ("chair",), sigmas=(5.0, 0.2), rates=(1e-4,))


class Run(NamedTuple):
    """One descent."""

    problem: str  # "shape", "masses" or "starts"
    scene: str
    recipe: str  # in words
    rate: float | None  # of plain gradient descent, or None
    seed: int  # of the problem
    seconds: float  # wall clock, measurements included, compilation not
    trace: Trace  # errors


class Summary(NamedTuple):
    """Medians over seeds of one recipe on one scene; names as in `Run`.

    Of plain gradient descent it is the rate with the lowest final loss.
    """

    problem: str
    scene: str
    recipe: str
    rate: float | None
    seconds: float
    losses: list[float]  # [n] mean over views, every so many iterations
    errors: list[list[float]]  # two [n], those that `BOUNDS` names


def follow(plan: Plan) -> Iterator[Run]:
    """All descents of a plan."""
    cooling = jnp.asarray(_cool(plan), jnp.float32)[:, None]
    for scene, seed in itertools.product(plan.scenes, range(plan.seeds)):
        problem = _make_shape(scene, plan, seed)
        for name, ends, rate in _list_recipes(plan):
            recipe = _make_recipe(plan, ends, rate=rate)
            yield _time("shape", scene, name, rate, seed, problem, recipe)
        recipe = _make_recipe(plan, (2.0, 0.5))._replace(
            point_rates=jnp.zeros((plan.steps, plan.points)),
            # Poses alone bear a larger rate.
            pose_rates=jnp.broadcast_to(0.03 * cooling, (plan.steps, VIEWS)),
        )
        for k in range(plan.starts):
            poses = _draw_poses(np.random.default_rng((seed, 1000 + k)))
            begun = problem._replace(start=(problem.surface, poses))
            yield _time("starts", scene, BEST, None, seed, begun, recipe)
    masses = np.geomspace(10, 1e-3, _FEW)
    for seed in range(plan.seeds):
        problem = _make_cloud(masses, seed)
        for name, rate, rates, memory in _list_mass_recipes(plan, masses):
            recipe = _make_recipe(plan, (1.0, 1.0), rate=rate)._replace(
                point_rates=jnp.asarray(rates, jnp.float32),
                pose_rates=jnp.zeros((plan.steps, VIEWS)),
                memory=jnp.asarray(memory),
            )
            yield _time("masses", "sparse", name, rate, seed, problem, recipe)


def _list_recipes(plan) -> Iterator[tuple]:
    """(name, first and last sigma, rate or None for Adam)."""
    for sigma in plan.sigmas:
        for rate in plan.rates:
            yield f"gradient, σ {sigma:g}", (sigma, sigma), rate
        yield f"Adam, σ {sigma:g}", (sigma, sigma), None
    for rate in plan.rates:
        yield "gradient, σ 2 → 0.5", (2.0, 0.5), rate
    yield "Adam, σ 5 → 0.2", (5.0, 0.2), None
    yield BEST, (2.0, 0.5), None


def _list_mass_recipes(plan, masses) -> Iterator[tuple]:
    """(name, rate, rates of the points [T, N], memory)."""
    flat = np.ones((plan.steps, _FEW))
    for rate in (1e-4, 3e-4, 1e-3):
        yield "gradient", rate, flat * rate, _MEMORY
    for rate in (3e-4, 1e-3, 3e-3):
        yield "gradient / mass", rate, flat * rate / masses, _MEMORY
    yield "Adam", None, flat * _cool(plan)[:, None] * 0.003, _MEMORY
    # A point starts when the heavier ones have come to rest, with a decay of its own.
    begin = 0.6 * plan.steps * np.arange(_FEW) / _FEW
    done = (np.arange(plan.steps)[:, None] - begin) / (0.4 * plan.steps)
    staged = np.where(done < 0, 0, 0.5 * (1 + np.cos(np.pi * np.clip(done, 0, 1))))
    yield STAGED, None, staged * 0.003, 0.9


def _make_shape(scene, plan, seed):
    """Nearly sharp targets of a scene; points start in a ball."""
    scenes = make_scenes(num_points=_DENSE, num_sparse=64, seed=seed)
    (cloud,) = (s.points for s in scenes if s.name == scene)
    rng = np.random.default_rng(seed)
    poses, surface = _draw_poses(rng), jnp.asarray(cloud, jnp.float32)
    dense = jnp.full(_DENSE, 2.0)
    targets = render_views(surface, poses, masses=dense, sigma=0.5)
    # The total mass does not depend on the number of points.
    masses = jnp.full(plan.points, 2400 / plan.points, jnp.float32)
    directions = rng.normal(size=(plan.points, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = 0.3 * directions * rng.uniform(0, 1, (plan.points, 1)) ** (1 / 3)
    turned = turn_randomly(poses, _OFF_DEG, rng).at[0].set(poses[0])
    start = jnp.asarray(ball, jnp.float32), turned
    return Problem(targets, poses, surface[: plan.points], masses, start)


def _make_cloud(masses, seed):
    """Points of these masses, displaced by 0.02."""
    rng = np.random.default_rng(seed)
    *_, cloud = make_scenes(num_points=64, num_sparse=len(masses), seed=seed)
    poses = _draw_poses(rng)
    points, masses = (jnp.asarray(a, jnp.float32) for a in (cloud.points, masses))
    targets = render_views(points, poses, masses=masses, sigma=1.0)
    moved = points + jnp.asarray(rng.normal(size=points.shape) * 0.02, jnp.float32)
    return Problem(targets, poses, points, masses, (moved, poses))


def _make_recipe(plan, ends: tuple[float, float], *, rate=None):
    """Gradient descent at a rate, or Adam; log sigma goes evenly between its ends."""
    factors = np.ones(plan.steps) if rate else _cool(plan)
    rates = jnp.asarray((rate or 0.01) * factors, jnp.float32)[:, None]
    return Recipe(
        jnp.asarray(np.geomspace(*ends, plan.steps), jnp.float32),
        jnp.broadcast_to(rates, (plan.steps, plan.points)),
        # The first pose is known and fixes the frame.
        jnp.broadcast_to(rates, (plan.steps, VIEWS)).at[:, 0].set(0),
        jnp.asarray(rate is None),
        jnp.asarray(_MEMORY),
    )


def _cool(plan):
    """Cosine decay of the learning rate, [T]."""
    return 0.5 * (1 + np.cos(np.pi * np.arange(plan.steps) / plan.steps))


def _draw_poses(rng):
    poses = rng.normal(size=(VIEWS, 4)).astype(np.float32)
    return jnp.asarray(poses / np.linalg.norm(poses, axis=1, keepdims=True))


def _time(name, scene, words, rate, seed, problem, recipe):
    compiled = _compile(*jax.tree.map(jax.typeof, (problem, recipe)))
    begin = time.perf_counter()
    trace = jax.block_until_ready(compiled(problem, recipe))
    seconds = time.perf_counter() - begin
    return Run(name, scene, words, rate, seed, seconds, jax.device_get(trace))


@functools.cache
def _compile(problem, recipe):
    """One program serves all descents of the same shapes."""
    return descend.lower(problem, recipe, every=EVERY).compile()


def summarize(runs: Sequence[Run]) -> list[Summary]:
    """Medians over seeds; of plain gradient descent the rate with the lowest loss."""
    groups: dict[tuple, list[Run]] = {}
    for r in runs:
        if r.problem != "starts":
            groups.setdefault(r[:4], []).append(r)
    best: dict[tuple, Summary] = {}
    for key, found in groups.items():
        losses, *errors = (
            np.median(values, axis=0).tolist()
            for values in zip(*map(_measure_errors, found), strict=True)
        )
        seconds = float(np.median([r.seconds for r in found]))
        other = best.get(key[:3])
        if other is None or losses[-1] < other.losses[-1]:
            problem, scene, recipe, rate = key
            best[key[:3]] = Summary(
                problem, scene, recipe, rate, seconds, losses, errors
            )
    return list(best.values())


def _measure_errors(run):
    """Loss and both errors of a run over its iterations."""
    trace, losses = run.trace, np.mean(run.trace.losses, axis=1)
    if run.problem == "shape":
        return losses, np.median(trace.pose_errors[:, 1:], axis=1), trace.chamfer
    third = trace.distances.shape[1] // 3
    squares = trace.distances.astype(np.float64) ** 2
    parts = squares[:, :third], squares[:, -third:]
    return losses, *(100 * np.sqrt(np.mean(part, axis=1)) for part in parts)


def choose_starts(runs: Sequence[Run]) -> list[tuple[str, int, float, float]]:
    """(scene, K, median error in degrees, share of views off by more than 30°).

    Of the first K starts each view keeps the one with the lowest loss.
    """
    by_scene: dict[str, dict[int, list[Run]]] = {}
    for r in runs:
        if r.problem == "starts":
            by_scene.setdefault(r.scene, {}).setdefault(r.seed, []).append(r)
    choices = []
    for scene, by_seed in by_scene.items():
        most = min(len(found) for found in by_seed.values())
        for count in (2**i for i in range(most.bit_length())):
            errors = []
            for found in by_seed.values():
                losses = np.array([r.trace.losses[-1] for r in found[:count]])
                angles = np.array([r.trace.pose_errors[-1] for r in found[:count]])
                errors.append(angles[np.argmin(losses, axis=0), range(VIEWS)])
            lost = float(np.mean(np.array(errors) >= 30))
            choices.append((scene, count, float(np.median(errors)), lost))
    return choices


def judge(runs: Sequence[Run], *, is_full: bool) -> Iterator[Row]:
    """Every descent must stay finite; the best recipes must arrive.

    The bounds belong to the full number of iterations. The loss of the best recipes
    must fall in any case.
    """
    row = functools.partial(Row, "descent", dtype="float32", because=_WHY)
    for r in runs:
        is_finite = all(np.all(np.isfinite(a)) for a in jax.tree.leaves(r.trace))
        name = f"{r.problem}, {r.scene}, {r.recipe}, rate {r.rate}, seed {r.seed}"
        error = float(np.mean(r.trace.losses[-1]))
        yield row(name, value_error=error, value_tolerance=None, is_finite=is_finite)
    for s in summarize(runs):
        if s.recipe not in (BEST, STAGED):
            continue
        name = f"{s.problem}, {s.scene}, {s.recipe}: "
        ratio = s.losses[-1] / s.losses[0]
        yield row(name + "last loss over first", value_error=ratio, value_tolerance=1)
        for (words, bound), errors in zip(BOUNDS[s.problem], s.errors, strict=True):
            if is_full:
                name_of = name + words
                yield row(name_of, value_error=errors[-1], value_tolerance=bound)
    choices = choose_starts(runs)
    for scene, count, _, lost in choices:
        if is_full and count == max(choice[1] for choice in choices):
            name = f"starts, {scene}: views lost with {count}"
            yield row(name, value_error=lost, value_tolerance=LOST_BOUND)


def write_section(runs: Sequence[Run], out: Path) -> str:
    """Two tables and a figure in the folder."""
    found, choices = summarize(runs), choose_starts(runs)
    draw_descents(found, out / FIGURE)
    rows = [
        (
            *(s.problem, s.scene, s.recipe, "" if s.rate is None else f"{s.rate:g}"),
            *(f"{s.losses[0]:.3g} → {s.losses[-1]:.3g}", f"{s.seconds:.2f}"),
            *(f"{errors[0]:.2g} → {errors[-1]:.2g}" for errors in s.errors),
        )
        for s in found
    ]
    heads = ("problem", "scene", "recipe", "rate", "loss", "run time (s)")
    starts = [(*c[:2], f"{c[2]:.1f}", f"{c[3]:.2f}") for c in choices]
    return "\n".join(
        [
            str(__doc__).partition("\n\n")[2],
            "Medians over seeds; of plain gradient descent the rate with the lowest "
            "loss. Losses are at σ 1 voxel for every recipe. The two errors: of shape "
            "the pose error (°) and the Chamfer distance ×100, of masses the distance "
            "×100 of the heaviest and of the lightest third from their places.",
            "",
            format_table((*heads, "first error", "second error"), rows),
            f"![error over iterations]({FIGURE})",
            "",
            format_table(("scene", "K starts", "median error (°)", "lost"), starts),
        ]
    )


def draw_descents(summaries: Sequence[Summary], path: Path) -> Path:
    """A row of panels for each scene: both errors over iterations, six recipes each."""
    scenes = list(dict.fromkeys((s.problem, s.scene) for s in summaries))
    figure = style.make_figure(11.0, 3.4 * len(scenes))
    panels = figure.subplots(len(scenes), 2, squeeze=False)
    for row, (problem, scene) in zip(panels, scenes, strict=True):
        chosen = [s for s in summaries if (s.problem, s.scene) == (problem, scene)]
        # Where there are more recipes: those of Adam, and the best gradient.
        slow = [s for s in chosen if s.recipe.startswith("gradient")]
        fast = [s for s in chosen if s not in slow]
        slow.sort(key=lambda s: s.losses[-1])
        chosen = [*fast[-5:], *slow][:6]
        for s, color in zip(chosen, style.SERIES, strict=False):
            for axes, errors in zip(row, s.errors, strict=True):
                iterations = EVERY * np.arange(len(errors))
                axes.semilogy(iterations, errors, color=color, label=s.recipe)
        for axes, (words, _) in zip(row, BOUNDS[problem], strict=True):
            title = f"{problem}, {scene}"
            style.label_axes(axes, title=title, x_label="iteration", y_label=words)
        row[1].legend(
            fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5)
        )
    return style.save_figure(figure, path)


def run(
    *, is_quick: bool, out: Path, tell: Callable[[str], None] = print
) -> tuple[list[Row], str]:
    """Rows of all descents, and their section of the report."""
    runs = list(follow(QUICK if is_quick else FULL))
    tell(f"descent: {len(runs)} descents")
    return list(judge(runs, is_full=not is_quick)), write_section(runs, out)
