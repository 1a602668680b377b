"""Cases of whole images: cameras, clouds, volumes of cells, and sums of many terms."""

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import draw_ball
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.functions import SHAPE, STILL
from dpc_jax.measure.stability.runner import IN_WIDE, Case, make_cases
from dpc_jax.render import (
    Camera,
    VoxelGrid,
    opacity,
    project,
    project_volume,
    smooth,
    termination_probabilities,
)
from dpc_jax.render import camera as cameras

TURN = (0.8, 0.1, -0.3, 0.2)  # a quaternion of nearly length one

# Cameras: points at, behind and before the eye.
GRID = VoxelGrid((8, 6, 4))
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.0, -0.35]])
EYE = np.array([[0, 0, 0.3], [0.01, 0.02, 0.2], [0, 0, 0]])
CROSSING = CLOUD * [1, 1, 0] + [[0, 0, -2], [0, 0, 0], [0, 0, 0.1]]
CLOSE = [[1e-6, -1e-6, 1e-5], [0, 0, 0.3], [0.1, 0, 0.2]]
# name, points, rotation, focal length, distance
SIGHTS = (
    ("plain", CLOUD, TURN, 1.875, 2.0),
    ("one point in the camera plane", CROSSING, STILL, 1.875, 2.0),
    ("distance 0", EYE, STILL, 0.5, 0.0),
    ("one point behind the camera", EYE - [0, 0, 0.1], STILL, 0.5, 0.0),
    (
        "one point 1e-7 before the plane",
        *(EYE + [0, 0, 1e-7], STILL, 0.5, 0.0, IN_WIDE),
    ),
    ("focal length 1e3, on the axis", CLOUD * [1e-4, 1e-4, 1], STILL, 1e3, 2.0),
    ("focal length 1e3 from 1e3", CLOUD, TURN, 1e3, 1024.0),
    ("points 3e38 away", np.sign(CLOUD) * 3e38, TURN, 1.875, 2.0),
    ("object larger than the volume", CLOUD * 4, TURN, 1.875, 2.0),
    ("quaternion of length 1e-30", CLOUD, np.multiply(TURN, 1e-30), 1.875, 2, IN_WIDE),
)


def _find_coordinates(points, rotation, focal, distance, *, projection):
    """Continuous indices of the points in the grid; zeros for points outside it."""
    camera = Camera(focal, distance, projection)
    moved = cameras.to_camera_frame(points, rotation, None)
    return cameras.to_grid(moved, camera=camera, grid=GRID)[0]


def _place(*inputs, is_flat):
    return oracles.place(*inputs, shape=GRID.shape, orthographic=is_flat)[0]


CAMERAS = [
    case
    # Perspective multiplies roundings by the inverse distance to the eye, orthographic
    # projection does not.
    for projection, close in (("perspective", 64e3), ("orthographic", 64))
    for case in make_cases(
        projection,
        functools.partial(_find_coordinates, projection=projection),
        functools.partial(_place, is_flat=projection == "orthographic"),
        (32, 64),
        [
            *SIGHTS,
            (
                *("1e-5 before the eye", CLOSE, STILL, 1.0, 0.0),
                IN_WIDE | {"gradient_tolerance": close},
            ),
        ],
        floor=1.0,
        is_half_checked=False,
    )
]

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
TAILS = {"gradient_tolerance": 4 * 1024}  # masses of 1e6: tails, at exponents of 14
NARROW = {"gradient_tolerance": 400 * 1024}  # a slope of 1/2σ² = 400 a voxel
# The gradient to a place is a difference of two cells' readings, which the wide kernel
# makes 3e-8 of what they are; so it is for the pose.
WIDE_KERNEL = {"gradient_floor": 3e-8}
# What differs from `PLAIN`, and the fields of `Case`.
SCENES = (
    ("plain", {}),
    ("no point near any ray", {"points": np.full((4, 3), 9.0)}),
    ("one point of mass 1e-30", {"scale": [1e-30, 0, 0, 0]}, IN_WIDE),
    ("the camera inside", {"distance": 0.0}, IN_WIDE),
    ("mass 0", {"scale": [0] * 4}),
    ("masses from 1e-12 to 1e6", {"scale": (1e-12, 1e-6, 1, 1e6)}, IN_WIDE | TAILS),
    ("colours 1e30", {"colors": COLORS * 1e30}, IN_WIDE),
    ("colours below 0", {"colors": -COLORS}),
    ("sigma 0", {"sizes": 0.0}),
    ("sigma 0.05", {"sizes": 0.05}, NARROW),
    ("sigma 1e3", {"sizes": 1e3}, IN_WIDE | WIDE_KERNEL),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("half turn", {"rotation": (0, 1, 0, 0)}),
    ("an object 1e6 wide", {"points": POINTS * 1e6}, IN_WIDE),
    ("an object 1e-6 wide", {"points": POINTS * 1e-6 + [0.1, 0.07, 0.03]}, IN_WIDE),
)


def _tilt(*sides):
    """Covariances, s² times one."""
    tilted = np.array([[1.5, 0.25, 0], [0.25, 1, -0.125], [0, -0.125, 1.25]])
    return {"sizes": np.square(sides)[:, None, None] * tilted}


TILTED = _tilt(0.6, 0.8, 1, 1.2)
MATRIX = oracles.rotate(np.eye(3), np.array(TURN)).T
COVARIANCES = (
    # The others turn by a quaternion.
    ("by a matrix", TILTED | {"rotation": MATRIX}, {"is_slow": True}),
    ("plain", TILTED),
    ("mass 0", TILTED | {"scale": [0] * 4}),
    ("sizes over 1e6", _tilt(1e-3, 0.3, 30, 1e3), IN_WIDE),
)


def _resize(scenes, resize):
    return [
        (name, changes | {"sizes": resize(changes.get("sizes", 0.6))}, *fields)
        for name, changes, *fields in scenes
    ]


# A spline is as wide as 0.6 voxels.
SPLINES = _resize(
    [row for row in SCENES if row[0] not in ("sigma 0", "sigma 0.05")],
    lambda sigma: max(sigma, 0.9),
)
# A size per point, which is what the method is for.
SIZES = [
    *_resize(SCENES, lambda sigma: np.multiply(sigma, [1, 1.5, 0.7, 1.1])),
    ("sizes from 1e-30 to 3e38", {"sizes": [1e-30, 0.3, 1e15, 3e38]}, IN_WIDE),
]
FOUR, LARGE = (5, 4, 6), (24, 17, 20)  # cells, of which a spline covers four
# Method, scenes, grid; in the large one the narrow points leave blocks out.
TABLES = (
    ("trilinear", SCENES, SHAPE),
    ("quadratic", SPLINES, FOUR),
    ("cubic", SPLINES, FOUR),
    ("blocks", SCENES, LARGE),
    ("gaussian", SIZES, SHAPE),
    ("covariance", COVARIANCES, SHAPE),
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


def _make_cases(title, function, oracle, plain, scenes) -> list[Case]:
    """Cases with the gradient to every input, which differ from the plain ones."""
    return make_cases(
        *(title, function, oracle, TOLERANCES),
        [
            (name, *(plain | changes).values(), *fields)
            for name, changes, *fields in scenes
        ],
        is_half_checked=False,
        gradient_floor=1e-30,
    )


def _list_images() -> list[Case]:
    cases = []
    for title, scenes, shape in TABLES:
        rules = {"method": title, "shape": shape}
        if title == "blocks":
            rules |= {"method": "trilinear", "max_blocks": 26}
        render = functools.partial(render_cloud, **rules)
        oracle = functools.partial(oracles.project, shape=shape, method=rules["method"])
        cases += _make_cases(title, render, oracle, PLAIN, scenes)
    return cases


# Volumes of cells.
CELLS = (2, 2, 4)  # of the grid, and of the volume
# The translation along x that moves the volume's rim, half a cell beyond its border, to
# the outermost samples on the right, of which the farthest is the last to be left.
LAST = {"perspective": 0.25 * 2.375 / 1.875 + 0.75, "orthographic": 1.0}


def _fill(shape):
    """Occupancies from 0.1 to 0.9 and two channels of colour, without a pattern."""
    numbers = np.arange(np.prod(shape))
    volume = 0.1 + 0.8 * ((numbers * 13) % 31) / 31
    colors = np.stack([(numbers * 7) % 11, (numbers * 5) % 17], axis=-1) / 16
    return {"volume": volume.reshape(shape), "colors": colors.reshape(*shape, 2)}


SOLID = _fill(CELLS) | {"rotation": TURN, **VIEW, "translation": (0.03, -0.05, 0.02)}
VOLUME = SOLID["volume"]
LONE, CHECKERS = np.eye(16)[6].reshape(CELLS), np.indices(CELLS).sum(0) % 2
# The samples are thousandths of the indices whose rounding they have.
GRAZING = {"value_tolerance": 8 * 1024, "gradient_tolerance": 8 * 1024}
# What differs from `SOLID`, and the fields of `Case`.
CELL_SCENES = (
    ("plain", {}),
    ("occupancies 0", {"volume": 0 * VOLUME}),
    ("occupancies 1", {"volume": 0 * VOLUME + 1}),
    ("one full cell, the others empty", {"volume": LONE}),
    ("full and empty cells in turn", {"volume": CHECKERS}),
    ("occupancies 1e-30", {"volume": VOLUME * 1e-30}, IN_WIDE),
    ("occupancies 1e30", {"volume": VOLUME * 1e30}, IN_WIDE),
    ("occupancies from -3 to 5", {"volume": VOLUME * 10 - 4}),
    ("colours 1e30", {"colors": SOLID["colors"] * 1e30}, IN_WIDE),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("quaternion 0", {"rotation": np.zeros(4)}),
    ("half turn", {"rotation": (0, 1, 0, 0)}),
    ("turned by 1e-6", {"rotation": (1, 1e-6, 0, 0)}, IN_WIDE),
    ("samples on cells' centres", {"rotation": STILL, "translation": np.zeros(3)}),
    ("moved by 3", {"translation": (3, 0, 0)}),
    ("moved behind the camera", {"translation": (0, 0, -9)}),
    ("moved by 3e38", {"translation": (3e38, 3e38, -3e38)}, IN_WIDE),
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
# Orthographic rays differ from the others in where they are, and in that alone.
ORTHOGRAPHIC = ("plain", "samples", "moved", "quaternion 0", "half")


def render_cells(volume, colors, rotation, *scene, **rules):
    """The three images of `project_volume`."""
    looks = _describe(*scene, shape=CELLS, **rules)
    image = project_volume(volume, rotation, colors=colors, **looks)
    return image.silhouette, image.depth, image.color


def _list_cells() -> list[Case]:
    cases = []
    for projection, names in (("perspective", ""), ("orthographic", ORTHOGRAPHIC)):
        is_flat = projection == "orthographic"
        scenes: list[tuple] = [row for row in CELL_SCENES if row[0].startswith(names)]
        # Rays on both sides of the rim, a thousandth of a cell from it.
        for side, step, fields in (("inside", -5e-4, GRAZING), ("outside", 5e-4, {})):
            moved = (LAST[projection] + step, 0.1, 0.07)
            name = f"the outermost ray a thousandth of a cell {side} of the rim"
            changes = {"rotation": STILL, "translation": moved}
            scenes.append((name, changes, IN_WIDE | fields))
        render = functools.partial(render_cells, projection=projection)
        oracle = functools.partial(
            oracles.project_volume, shape=CELLS, orthographic=is_flat
        )
        cases += _make_cases(projection, render, oracle, SOLID, scenes)
    return cases


# Sums of more and more terms, beside the function itself in float64. Independent
# rounding errors of n terms add up as √n, and so do the tolerances.
def _render_many(points, rotation, scale, sizes, *, method):
    """A silhouette of 16² pixels; the mass is shared out among the points."""
    look = {"grid": VoxelGrid(16), "scale": scale / len(points)}
    is_round = jnp.ndim(sizes) < 3
    look |= {"sigma": sizes, "method": method} if is_round else {"covariance": sizes}
    return project(points, rotation, **look).silhouette


_TRILINEAR, _CUBIC, _GAUSSIAN, _LEVELS = (
    functools.partial(_render_many, method=method)
    for method in ("trilinear", "cubic", "gaussian", "levels")
)
# What adds up how many terms n of which kind, and the tolerance of the gradient in
# units of √n epsilons; that of the value is four. Each is at least four times the
# largest error measured.
SUMS = (
    # Trilinear weights have a kink at a cell's centre: of 10⁵ points one lies within
    # rounding of it, and float32 takes the other side's slope.
    ("trilinear", _TRILINEAR, "points", 1000, 64),
    ("trilinear", _TRILINEAR, "points", 100_000, 64),
    ("cubic", _CUBIC, "points", 1000, 16),
    ("gaussian", _GAUSSIAN, "points", 1000, 64),
    ("gaussian", _GAUSSIAN, "points", 100_000, 64),
    ("gaussian", _GAUSSIAN, "points of all sizes", 1000, 16),
    ("levels", _LEVELS, "points of all sizes", 1000, 16),
    ("gaussian", _GAUSSIAN, "points of covariances", 200, 16),
    ("loss", reprojection_loss, "pixels", 100_000, 4),
    # A cell is a sum along each axis, sigma's gradient one over all cells: √n³.
    ("smooth", smooth, "cells", 16, 4),
    ("smooth", smooth, "cells", 128, 32),
    ("opacity", opacity, "cells of a ray", 64, 4),
    ("opacity", opacity, "cells of a ray", 4096, 4),
    ("termination", termination_probabilities, "cells of a ray", 64, 4),
    ("termination", termination_probabilities, "cells of a ray", 4096, 4),
)


def _draw(kind, n):
    """The inputs of a sum of n terms."""
    rng = np.random.default_rng(n)
    points = draw_ball(rng, n) * (0.42, 0.28, 0.16)
    if kind.startswith("points"):
        # A fixed mass fills an ellipsoid to a half. It is turned, so that no symmetry
        # makes the rotation's gradient vanish.
        sizes = {"points": 1.0, "points of all sizes": rng.uniform(0.7, 2.5, n)}
        axes = rng.normal(0, 0.8, (n, 3, 3))
        matrices = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(3)
        return points, (0.8, 0.4, 0, 0.4), 160, sizes.get(kind, matrices)
    if kind == "pixels":
        return tuple(rng.uniform(0, 1, (2, n)))
    if kind == "cells":
        return rng.uniform(0, 1, (n, n, n)), n / 8
    return (rng.uniform(0, 4 / n, (16, n)),)  # the rays' sums stay at two


def _list_sums() -> list[Case]:
    """Cases of sums over points, cells, pixels and rays."""
    cases = []
    for title, function, kind, n, tolerance in SUMS:
        tolerances = 4 * math.sqrt(n), tolerance * math.sqrt(n)
        cases += make_cases(
            f"{title}, {kind}",
            *(function, None, tolerances, [(str(n), *_draw(kind, n))]),
            is_slow=n > 64,
            dtypes=("float32",),
        )
    return cases


CASES = {
    "camera": CAMERAS,
    "image": _list_images(),
    "cells": _list_cells(),
    "sum": _list_sums(),
}
