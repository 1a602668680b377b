"""Cases of whole images: clouds, volumes of cells, and sums of many points."""

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.scenes import draw_ball
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.functions import SHAPE, STILL
from dpc_jax.measure.stability.runner import IN_WIDE, Case, make_cases
from dpc_jax.render import Camera, VoxelGrid, project, project_volume

TURN = (0.8, 0.1, -0.3, 0.2)  # a quaternion of nearly length one

# Clouds. Coordinates of a few cells carry 30 roundings, kernels multiply them by their
# slope, rays by their length.
TOLERANCES = 128, 1024
POINTS = np.array(
    [[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.01, -0.35], [-0.1, -0.2, 0.13]]
)
COLORS = np.array([[0.1, 0.9], [0.5, 0.2], [0.0, 1.0], [0.7, 0.7]])
VIEW = {"translation": (0, 0, 0), "focal": 1.875, "distance": 2.0}
VIEW |= {"background_depth": 10.0, "background_color": (1.0, 0.25)}
PLAIN = {"points": POINTS, "rotation": TURN, "sizes": 0.6, "scale": [0.6] * 4}
PLAIN |= {"colors": COLORS, **VIEW}
# Scenes that multiply roundings by more than that.
# Of masses of 1e6 tails are seen, at exponents of 14.
TAILS = {"value_tolerance": 4 * 128, "gradient_tolerance": 4 * 1024}
NARROW = {"gradient_tolerance": 400 * 1024}  # a slope of 1/2σ² = 400 a voxel
# The gradient to a place is a difference of two cells' readings, which the wide kernel
# makes 3e-8 of what they are; so it is for the pose.
WIDE_KERNEL = {"gradient_floor": 3e-8}
# One point before the eye; within a millionth, in its plane and behind it none counts.
EYE = [[0.01, 0.02, 0.3], [0, 0, 1e-7], [0, 0, 0], [0, 0, -0.1]]
AT_EYE = {"points": EYE, "rotation": STILL, "focal": 0.5, "distance": 0.0}
# What differs from `PLAIN`, and the fields of `Case`.
SCENES = (
    ("plain", {}),
    ("no point near any ray", {"points": np.full((4, 3), 9.0)}),
    ("one point of mass 1e-30", {"scale": [1e-30, 0, 0, 0]}, IN_WIDE),
    ("the camera inside", {"distance": 0.0}, IN_WIDE),
    ("points before, at and behind the eye", AT_EYE, IN_WIDE),
    ("focal length 1e3 from 1e3", {"focal": 1e3, "distance": 1024.0}, IN_WIDE),
    ("points 3e38 away", {"points": np.sign(POINTS) * 3e38}, IN_WIDE),
    ("mass 0", {"scale": [0] * 4}),
    ("masses from 1e-12 to 1e6", {"scale": (1e-12, 1e-6, 1, 1e6)}, IN_WIDE | TAILS),
    ("colours 1e30", {"colors": COLORS * 1e30}, IN_WIDE),
    ("colours below 0", {"colors": -COLORS}),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("half turn", {"rotation": (0, 1, 0, 0)}),
    ("an object 1e6 wide", {"points": POINTS * 1e6}, IN_WIDE),
    ("an object 1e-6 wide", {"points": POINTS * 1e-6 + [0.1, 0.07, 0.03]}, IN_WIDE),
)
THIN_SIGMAS = (
    ("sigma 0", {"sizes": 0.0}),
    ("sigma 0.05", {"sizes": 0.05}, NARROW),
)
WIDE_SIGMA = ("sigma 1e3", {"sizes": 1e3}, IN_WIDE | WIDE_KERNEL)
# A size per point, which is what the exact method is for.
SIZES = np.array([0.6, 0.9, 0.4, 0.7])
EXACT = (
    ("sizes 0", {"sizes": 0 * SIZES}),
    ("sizes 0.05", {"sizes": SIZES / 12}, NARROW),
    ("sizes 1e3", {"sizes": SIZES * 1e3}, IN_WIDE | WIDE_KERNEL),
    ("sizes from 1e-30 to 3e38", {"sizes": [1e-30, 0.3, 1e15, 3e38]}, IN_WIDE),
)
TILTED = np.array([[1.5, 0.25, 0], [0.25, 1, -0.125], [0, -0.125, 1.25]])
VARIANCES = np.square([0.6, 0.8, 1, 1.2])[:, None, None]
MATRIX = oracles.rotate(np.eye(3), np.array(TURN)).T
COVARIANCES = (
    # The others turn by a quaternion.
    ("by a matrix", {"rotation": MATRIX}, {"is_slow": True}),
    ("plain", {}),
    ("mass 0", {"scale": [0] * 4}),
    (
        "sizes over 1e6",
        {"sizes": np.square([1e-3, 0.3, 30, 1e3])[:, None, None] * TILTED},
        IN_WIDE,
    ),
)
FOUR, LARGE = (5, 4, 6), (17, 16, 12)  # cells, of which a spline covers four
# Method, sizes, scenes, grid. A spline is as wide as 0.6 voxels; in the large grid the
# narrow points leave blocks out.
TABLES = (
    ("trilinear", 0.6, (*SCENES, *THIN_SIGMAS, WIDE_SIGMA), SHAPE),
    ("quadratic", 0.9, (*SCENES, WIDE_SIGMA), FOUR),
    ("cubic", 0.9, (*SCENES, WIDE_SIGMA), FOUR),
    ("blocks", 0.6, (*SCENES, *THIN_SIGMAS, WIDE_SIGMA), LARGE),
    ("gaussian", SIZES, (*SCENES, *EXACT), SHAPE),
    ("covariance", VARIANCES * TILTED, COVARIANCES, SHAPE),
)


def _describe(
    translation,
    focal,
    distance,
    depth=10.0,
    color=1.0,
    *,
    shape=SHAPE,
    projection="perspective",
    **rules,
) -> dict[str, Any]:
    """What `project` and `project_volume` take alike."""
    return {
        "translation": translation,
        "camera": Camera(focal, distance, projection),
        "grid": VoxelGrid(shape),
        "signals": ("silhouette", "depth", "color"),
        "background_depth": depth,
        "background_color": color,
    } | rules


def render_cloud(points, rotation, sizes, scale, colors, *scene, method, **rules):
    """The three images of `project`; sizes are sigma () or [N], or covariances."""
    looks = _describe(*scene, **rules)
    is_round = jnp.ndim(sizes) < 3
    looks |= {"sigma": sizes, "method": method} if is_round else {"covariance": sizes}
    image = project(points, rotation, scale=scale, colors=colors, **looks)
    return image.silhouette, image.depth, image.color


def _make_cases(title, function, oracle, plain, scenes, **fields) -> list[Case]:
    """Cases with the gradient to every input, which differ from the plain ones."""
    return make_cases(
        *(title, function, oracle, TOLERANCES),
        [
            (name, *(plain | changes).values(), *others)
            for name, changes, *others in scenes
        ],
        is_half_checked=False,
        gradient_floor=1e-30,
        **fields,
    )


def _list_images() -> list[Case]:
    cases = []
    for title, sizes, scenes, shape in TABLES:
        rules: dict[str, Any] = {"method": title, "shape": shape}
        if title == "blocks":
            rules |= {"method": "trilinear", "max_blocks": 11}
        render = functools.partial(render_cloud, **rules)
        oracle = functools.partial(oracles.project, shape=shape, method=rules["method"])
        plain = PLAIN | {"sizes": sizes}
        # The oracle's grid of blocks is large; both splines smooth alike.
        is_slow = title in ("blocks", "quadratic")
        cases += _make_cases(title, render, oracle, plain, scenes, is_slow=is_slow)
    return cases


# Volumes of cells.
CELLS = (2, 2, 4)  # of the grid, and of the volume


def _fill(shape):
    """Occupancies from 0.1 to 0.9 and two channels of colour, without a pattern."""
    numbers = np.arange(np.prod(shape))
    volume = 0.1 + 0.8 * ((numbers * 13) % 31) / 31
    colors = np.stack([(numbers * 7) % 11, (numbers * 5) % 17], axis=-1) / 16
    return {"volume": volume.reshape(shape), "colors": colors.reshape(*shape, 2)}


SOLID = _fill(CELLS) | {"rotation": TURN, **VIEW, "translation": (0.03, -0.05, 0.02)}
VOLUME = SOLID["volume"]
LONE, CHECKERS = np.eye(16)[6].reshape(CELLS), np.indices(CELLS).sum(0) % 2
# What differs from `SOLID`, and the fields of `Case`. Orthographic rays differ from the
# others in where they are, and in that alone.
PLACES = (
    ("plain", {}),
    ("quaternion 0", {"rotation": np.zeros(4)}),
    ("half turn", {"rotation": (0, 1, 0, 0)}),
    ("samples on cells' centres", {"rotation": STILL, "translation": np.zeros(3)}),
    ("moved by 3", {"translation": (3, 0, 0)}),
    ("moved behind the camera", {"translation": (0, 0, -9)}),
    ("moved by 3e38", {"translation": (3e38, 3e38, -3e38)}, IN_WIDE),
)
CELL_SCENES = (
    *PLACES,
    ("occupancies 0", {"volume": 0 * VOLUME}),
    ("occupancies 1", {"volume": 0 * VOLUME + 1}),
    ("one full cell, the others empty", {"volume": LONE}),
    ("full and empty cells in turn", {"volume": CHECKERS}),
    ("occupancies 1e-30", {"volume": VOLUME * 1e-30}, IN_WIDE),
    ("occupancies 1e30", {"volume": VOLUME * 1e30}, IN_WIDE),
    ("occupancies from -3 to 5", {"volume": VOLUME * 10 - 4}),
    ("colours 1e30", {"colors": SOLID["colors"] * 1e30}, IN_WIDE),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("turned by 1e-6", {"rotation": (1, 1e-6, 0, 0)}, IN_WIDE),
    ("the camera inside", {"distance": 0.1}),
    # By `TURN` a sample would lie on a cell's centre, but for rounding.
    (
        "the camera in the middle",
        {"distance": 0.0, "rotation": (0.8, 0.13, -0.3, 0.21)},
    ),
    ("distance 1e6, focal length 1e6", {"distance": 1e6, "focal": 1e6}, IN_WIDE),
    ("distance 1e30", {"distance": 1e30}, IN_WIDE),
    ("focal length 1e-6", {"focal": 1e-6}, IN_WIDE),
    ("focal length 1e30", {"focal": 1e30}, IN_WIDE),
    ("one cell", _fill((1, 1, 1)), {"is_slow": True}),
    ("a plate one cell thick", _fill((5, 1, 4)), {"is_slow": True}),
)


def render_cells(volume, colors, rotation, *scene, **rules):
    """The three images of `project_volume`."""
    looks = _describe(*scene, shape=CELLS, **rules)
    image = project_volume(volume, rotation, colors=colors, **looks)
    return image.silhouette, image.depth, image.color


def _list_cells() -> list[Case]:
    cases = []
    for projection, scenes in (("perspective", CELL_SCENES), ("orthographic", PLACES)):
        render = functools.partial(render_cells, projection=projection)
        is_flat = projection == "orthographic"
        oracle = functools.partial(
            oracles.project_volume, shape=CELLS, orthographic=is_flat
        )
        cases += _make_cases(projection, render, oracle, SOLID, scenes)
    return cases


# Sums of more and more points, beside the function itself in float64. Method, number of
# points, whether each has its own size, and the tolerance of the gradient in units of
# √n epsilons, as independent rounding errors of n terms add up; that of the value is
# four. Each is at least four times the largest error measured.
SUMS = (
    # Trilinear weights have a kink at a cell's centre: of 10⁵ points one lies within
    # rounding of it, and float32 takes the other side's slope.
    ("trilinear", 1000, False, 64),
    ("trilinear", 100_000, False, 64),
    ("cubic", 1000, False, 16),
    ("gaussian", 1000, False, 64),
    ("gaussian", 100_000, False, 64),
    ("gaussian", 1000, True, 16),
)


def _render_many(points, rotation, scale, sigma, *, method):
    """A silhouette of 16² pixels; the mass is shared out among the points."""
    looks = {"grid": VoxelGrid(16), "scale": scale / len(points), "method": method}
    return project(points, rotation, sigma=sigma, **looks).silhouette


def _list_sums() -> list[Case]:
    cases = []
    for method, n, has_sizes, tolerance in SUMS:
        rng = np.random.default_rng(n)
        points = draw_ball(rng, n) * (0.42, 0.28, 0.16)
        sizes = rng.uniform(0.7, 2.5, n) if has_sizes else 1.0
        title = f"{method}, points of all sizes" if has_sizes else f"{method}, points"
        # A fixed mass fills an ellipsoid to a half. It is turned, so that no symmetry
        # makes the rotation's gradient vanish.
        rows = [(str(n), points, (0.8, 0.4, 0, 0.4), 160, sizes)]
        cases += make_cases(
            *(title, functools.partial(_render_many, method=method), None),
            *((4 * math.sqrt(n), tolerance * math.sqrt(n)), rows),
            is_slow=n > 1000,
            dtypes=("float32",),
        )
    return cases


CASES = {"image": _list_images(), "cells": _list_cells(), "sum": _list_sums()}
