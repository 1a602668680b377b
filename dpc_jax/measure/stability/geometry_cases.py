"""Rotations of extreme lengths and angles; points at, behind and before the eye."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.case import IN_WIDE, SKEW, STILL, TURN, WIDE, make_cases
from dpc_jax.measure.stability.runner import tabulate
from dpc_jax.render import camera as cameras
from dpc_jax.render import quaternion

ROUNDING = "a dozen roundings, each half an epsilon; numbers of size one"
LENGTHS = (
    ("length 1e-30", np.multiply(SKEW, 1e-30)),
    ("length 1e30", np.multiply(SKEW, 1e30)),
    # 1 / 9e37 is subnormal, which processors flush to zero.
    ("length 1.3e38", (0, 0, 9e37, -9e37), IN_WIDE),
    ("components from 1e-30 to 1", (1e-30, 1, 1e-15, -1e-3)),
    ("near identity, 1e-7", (1, 1e-7, -1e-7, 2e-7)),
    ("zero", [0] * 4),
)
POINTS = np.array([[0.3, -0.4, 0.5], [1e-7, 1, 1e3], [0, 0, 0]])
PAIRS = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("1e30 by 1e-30", np.multiply(SKEW, 1e30), (1e-30, 2e-30, 3e-30, 4e-30)),
)
BRANCHES = (
    ("w largest", (1, 0.1, -0.2, 0.3)),
    ("x largest", (0.1, 1, -0.2, 0.3)),
    ("y largest", (0.1, -0.2, -1, 0.3)),
    ("z largest", (0.1, -0.2, 0.3, 1)),
    ("half turn about x", (0, 1, 0, 0)),
    ("half turn, two branches tie", (0, np.sqrt(0.5), np.sqrt(0.5), 0)),
    ("1e-7 from a half turn", (1e-7, 1, -2, 3)),
    ("all four tie", (1, -1, 1, 1)),
    ("identity", STILL),
)
# In 16 bits these round to equal rotations, or to subnormal numbers.
ANGLES = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("1e30 and 1e-30", np.multiply(SKEW, 1e30), (1e-30, 0, 1e-30, 0)),
    ("q and -q", (0.5, 0.5, -0.5, 0.5), (-0.5, -0.5, 0.5, -0.5)),
    ("equal", STILL, STILL),
    ("1e-25 apart", (1, 1e-25, 0, 0), STILL, IN_WIDE),
    ("1e-7 apart", (1, 1e-7, 0, 0), (1, 0, 1e-7, 0), IN_WIDE),
    ("half turn", STILL, (0, 0, 1, 0)),
    ("1e-7 from a half turn", STILL, (1e-7, 0, 1, 0)),
)
ABOUT = {"0": 0.0, "1e-30": 1e-30, "a half turn": np.pi, "1e4": 1e4}


def _pass_through_matrix(q):
    """As q·qᵀ, which is the same for q and -q."""
    back = jnp.asarray(quaternion.from_matrix(quaternion.to_matrix(q)))
    return jnp.outer(back, back)


def _square(q):
    return np.outer(oracles.normalize(q), oracles.normalize(q))


def _turn_about(axis, angle):
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


_make = functools.partial(make_cases, because=ROUNDING)
ROTATIONS = [
    *_make("normalize", quaternion.normalize, oracles.normalize, (4, 16), LENGTHS),
    *_make("multiply", quaternion.multiply, oracles.multiply, (8, 8), PAIRS),
    *make_cases(
        *("rotate", quaternion.rotate, oracles.rotate, (16, 64)),
        [(name, POINTS, *rest) for name, *rest in LENGTHS],
        because=ROUNDING + "; the gradient of q cancels along q",
    ),
    *_make("matrix and back", _pass_through_matrix, _square, (8, 32), BRANCHES),
    *_make("angle", quaternion.angle_between, oracles.angle, (16, 64), ANGLES),
    *_make(
        *("from axis and angle", quaternion.from_axis_angle, _turn_about, (4, 8)),
        [(name, (0.0, -0.6, 0.8), angle) for name, angle in ABOUT.items()],
        dtypes=WIDE,
    ),
]

GRID = cameras.VoxelGrid((8, 6, 4))
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.0, -0.35]])
EYE = np.array([[0, 0, 0.3], [0.01, 0.02, 0.2], [0, 0, 0]])
CROSSING = CLOUD * [1, 1, 0] + [[0, 0, -2], [0, 0, 0], [0, 0, 0.1]]
CLOSE = [[1e-6, -1e-6, 1e-5], [0, 0, 0.3], [0.1, 0, 0.2]]
# name, points, rotation, focal length, distance
NEAR_EYE = ("1e-5 before the eye", CLOSE, STILL, 1.0, 0.0)
SCENES = (
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
    camera = cameras.Camera(focal, distance, projection)
    moved = cameras.to_camera_frame(points, rotation, translation=None, camera=camera)
    return cameras.to_grid(moved, camera=camera, grid=GRID).coordinates


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
        [*SCENES, (*NEAR_EYE, IN_WIDE | {"gradient_tolerance": close})],
        because="30 roundings of numbers of a few cells; a point close to the eye "
        "multiplies them",
        floor=1.0,
        is_half_checked=False,
    )
]
ROWS = tabulate(rotation=ROTATIONS, camera=CAMERAS)
