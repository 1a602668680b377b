"""Whole images of clouds and of volumes of cells: poses, lenses, masses, empty rays."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.case import IN_WIDE, STILL, TURN, Case, make_cases
from dpc_jax.measure.stability.runner import tabulate
from dpc_jax.render import Camera, VoxelGrid, project, project_volume

SHAPE = (4, 3, 5)
POINTS = np.array(
    [[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.01, -0.35], [-0.1, -0.2, 0.13]]
)
COLORS = np.array([[0.1, 0.9], [0.5, 0.2], [0.0, 1.0], [0.7, 0.7]])
CAMERA = {"translation": (0, 0, 0), "focal": 1.875, "distance": 2.0}
CAMERA |= {"background_depth": 10.0, "background_color": (1.0, 0.25)}
PLAIN = {"points": POINTS, "rotation": TURN, "sizes": 0.6, "scale": [0.6] * 4}
PLAIN |= {"colors": COLORS, **CAMERA}
MATRIX = oracles.rotate(np.eye(3), np.array(TURN)).T
MANY = (1e-12, 1e-6, 1, 1e6)

ROUNDINGS = "coordinates of a few cells carry 30 roundings, kernels multiply them by "
ROUNDINGS += "their slope, rays by their length"
# Scenes that multiply roundings by more than that.
TAILS = {
    "gradient_tolerance": 4 * 1024,
    "because": ROUNDINGS + "; of mass 1e6 the tails count, at exponents of 14",
}
NARROW = {
    "gradient_tolerance": 400 * 1024,
    "because": ROUNDINGS + "; so narrow a kernel has slopes of 1/2σ² = 400 a voxel",
}
# The gradient to a place is a difference of two cells' readings, which the wide kernel
# makes 3e-8 of what they are; so it is for the pose.
PLACES = ("points", "rotation", "translation", "focal", "distance")
WIDE_KERNEL = {
    "gradient_floor": tuple(3e-8 if name in PLACES else 1e-30 for name in PLAIN)
}
# What differs from `PLAIN`, and the fields of `Case`.
SCENES = (
    ("plain", {}),
    ("no point near any ray", {"points": np.full((4, 3), 9.0)}),
    ("one point of mass 1e-30", {"scale": [1e-30, 0, 0, 0]}, IN_WIDE),
    ("the camera inside", {"distance": 0.0}, IN_WIDE),
    ("mass 0", {"scale": [0] * 4}),
    ("masses from 1e-12 to 1e6", {"scale": MANY}, IN_WIDE | TAILS),
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


def render_cells(volume, colors, rotation, *scene, **rules):
    """The three images of `project_volume`."""
    looks = _describe(*scene, shape=CELLS, **rules)
    image = project_volume(volume, rotation, colors=colors, **looks)
    return image.silhouette, image.depth, image.color


def _make_cases(title, function, oracle, plain, scenes) -> list[Case]:
    """Cases with the gradient to every input, which differ from the plain ones."""
    return make_cases(
        *(title, function, oracle, (128, 1024)),
        [
            (name, *(plain | changes).values(), *fields)
            for name, changes, *fields in scenes
        ],
        because=ROUNDINGS,
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


SOLID = _fill(CELLS) | {"rotation": TURN, **CAMERA, "translation": (0.03, -0.05, 0.02)}
VOLUME = SOLID["volume"]
LONE, CHECKERS = np.eye(16)[6].reshape(CELLS), np.indices(CELLS).sum(0) % 2
GRAZING = {
    "value_tolerance": 8 * 1024,
    "gradient_tolerance": 8 * 1024,
    "because": "the samples are thousandths of the indices whose rounding they have",
}
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


def _list_cells() -> list[Case]:
    cases = []
    for projection, names in (("perspective", ""), ("orthographic", ORTHOGRAPHIC)):
        is_flat = projection == "orthographic"
        scenes = [row for row in CELL_SCENES if row[0].startswith(names)]
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


ROWS = tabulate(image=_list_images(), cells=_list_cells())
