"""Learning: ties between candidates, empty and full views, ends of schedules."""

import functools

import chex
import jax.numpy as jnp
import numpy as np

from dpc_jax.config.settings import Settings
from dpc_jax.learning import hindsight, losses, schedules
from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import WIDE, Case, make_cases
from dpc_jax.render import Camera, VoxelGrid, project

SUBJECT = "learning"
FIT_SHAPE = (4, 4, 4)


def list_cases() -> list[Case]:
    """The catalogue's cases on the hindsight choice, fits of one view and schedules."""
    return [*_list_choices(), *_list_fits(), *_list_schedules()]


def choose(
    points: chex.Array, candidates: chex.Array, target: chex.Array
) -> chex.Array:
    """The winner's index, as a float so that it is compared like other outputs."""
    index = hindsight.choose_candidate(
        points,
        jnp.ones((), points.dtype),
        candidates,
        target,
        sigma=jnp.asarray(0.7, points.dtype),
        camera=Camera(),
    )
    return index.astype(points.dtype)


def sum_half_turns(covariance: chex.Array) -> chex.Array:
    """Σ q·qᵀ of the half turns about the principal axes.

    The sum is the same for every choice of the axes, which are arbitrary in a tie.
    """
    turns = hindsight.find_half_turns(covariance)
    return jnp.einsum("ti,tj->ij", turns, turns)


IDENTITY, TURNED = (1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)
POINTS = np.array([[0.3, 0.1, 0.0], [-0.2, 0.25, 0.1], [0.1, -0.3, 0.2]])
EMPTY = np.zeros((4, 4))
# The silhouette of `POINTS` without rotation, rounded.
SEEN = EMPTY.copy()
SEEN[3, 1] = SEEN[2, 3] = SEEN[0, 2] = 1.0
# name, points, candidates, target, the winner
CHOICES = (
    ("identical candidates", POINTS, [TURNED] * 3, SEEN, 0),
    ("q and -q tie", POINTS, [TURNED, IDENTITY, np.negative(IDENTITY)], SEEN, 1),
    (
        "empty silhouette, no point seen",
        *(POINTS + 9, [IDENTITY, TURNED, TURNED], EMPTY, 0),
    ),
    ("full silhouette, identical candidates", POINTS, [TURNED] * 3, EMPTY + 1, 0),
)
COVARIANCES = (
    ("plain", np.diag([3.0, 2, 1])),
    ("equal axes", np.eye(3)),
    ("zero", np.zeros((3, 3))),
    ("a line", np.diag([1.0, 0, 0])),
    ("entries 1e-30", np.eye(3) * 1e-30),
)


def _list_choices():
    make = functools.partial(make_cases, subject=SUBJECT, dtypes=WIDE)
    rows = [
        (*row, {"oracle": lambda *inputs, winner=winner: np.asarray(winner)})
        for *row, winner in CHOICES
    ]
    return [
        *make(
            "choice",
            *(choose, None, (0, None), rows),
            because="an index; of equal candidates the first",
        ),
        *make(
            "half turns",
            *(sum_half_turns, lambda covariance: np.eye(4), (16, None), COVARIANCES),
            because="orthonormal axes, to a few roundings",
        ),
    ]


def fit(points: chex.Array, rotation: chex.Array, target: chex.Array) -> chex.Array:
    """Loss of one view of a cloud, whose gradient training takes."""
    image = project(
        points, rotation, sigma=0.7, scale=2.0, grid=VoxelGrid(FIT_SHAPE)
    ).silhouette
    return losses.reprojection_loss(image, target)  # pyright: ignore[reportArgumentType]


def find_fit(
    points: np.ndarray, rotation: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """The oracle of `fit`."""
    colors = np.zeros((len(points), 1))
    silhouette, _, _ = image_oracles.render(
        points, rotation, 0.7, 2.0, colors, shape=FIT_SHAPE
    )
    return np.sum((silhouette - target) * (silhouette - target))


def _list_fits():
    points = np.array([[0.3, 0.1, 0.0], [-0.2, 0.24, 0.1], [0.1, -0.3, 0.2]])
    pose = (0.8, 0.1, -0.3, 0.2)
    rows = (
        ("empty silhouette", points, pose, EMPTY),
        ("full silhouette", points, pose, EMPTY + 1),
        ("full silhouette, no point seen", points + 9, pose, EMPTY + 1),
        ("full silhouette, coincident points", points[[0, 0, 0]], pose, EMPTY + 1),
    )
    return make_cases(
        "fit of a view",
        *(fit, find_fit, (128, 1024), rows),
        subject=SUBJECT,
        because="coordinates of a few cells carry 30 roundings, the kernel multiplies "
        "them by its slope, and 16 pixels are summed",
        dtypes=WIDE,
    )


def make_settings(**changes) -> Settings:
    """A run in miniature, with every schedule in use."""
    values = dict(
        steps=1000,
        models_per_batch=2,
        views_per_batch=2,
        grid=8,
        fine_grid=0,
        fine_from=0.5,
        num_points=24,
        num_candidates=3,
        flips=False,
        selects=False,
        choice_grid=0,
        choice_points=0,
        choice_top=0,
        student_weight=0.01,
        sigma_start=0.1,
        sigma_end=0.01,
        anneal_until=0.8,
        keep_start=0.5,
        keep_end=1.0,
        keep_levels=4,
        scale_unit="mass",
        learning_rate=1e-3,
        warmup_steps=100,
        final_rate=0.02,
        weight_decay=0.0,
        repulsion_weight=0.0,
        repulsion_points=0,
        containment_weight=0.0,
        color_weight=0.0,
        focal_length=1.875,
        distance=2.0,
        renders_at_once=0,
        seed=0,
    )
    return Settings(**values | changes)


@functools.cache
def make_schedules(settings: Settings):
    """(sigma, learning rate, share of points) of a step."""
    rate = schedules.make_learning_rate(settings)

    def compute(step):
        return schedules.compute_sigma(step, settings), rate(step)

    return compute


def find_schedules(
    step: np.ndarray, *, settings: Settings
) -> tuple[np.ndarray, np.ndarray]:
    """The oracle of `make_schedules`."""
    done = min(max(float(step) / (settings.anneal_until * settings.steps), 0), 1)
    share = settings.sigma_start
    share += done * (settings.sigma_end - settings.sigma_start)
    warm = settings.warmup_steps
    peak, last = settings.learning_rate, settings.final_rate
    if step < warm:
        rate = peak / warm + (peak - peak / warm) * float(step) / warm
    else:
        part = min((float(step) - warm) / (settings.steps - warm), 1)
        rate = peak * ((1 - last) * (1 + np.cos(np.pi * part)) / 2 + last)
    return np.asarray(share * settings.grid), np.asarray(rate)


def _list_schedules():
    kinds = {
        "plain": make_settings(),
        "one step": make_settings(steps=1, warmup_steps=0),
        "no annealing, constant rate": make_settings(
            anneal_until=1.0, final_rate=1.0, warmup_steps=0
        ),
    }
    for name, settings in kinds.items():
        steps = {0, 100, 800, settings.steps - 1, settings.steps, 10**6}
        yield from make_cases(
            "schedules",
            make_schedules(settings),
            functools.partial(find_schedules, settings=settings),
            (256, None),
            [(f"{name}, step {step}", step) for step in sorted(steps)],
            subject=SUBJECT,
            because="a cosine whose argument has the rounding of a step's share; the "
            "first rate is a hundredth of the difference it comes from",
            dtypes=("float32",),
        )
