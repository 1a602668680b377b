"""Cameras: points at, behind and just before the eye, far away, extreme lenses."""

import functools

import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import IN_WIDE, Case, make_cases
from dpc_jax.render import camera as cameras

SUBJECT = "camera"
SHAPE = (8, 6, 4)
GRID = cameras.VoxelGrid(SHAPE)
PLAIN = np.array([[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.0, -0.35]])
TURN = (0.8, 0.1, -0.3, 0.2)
TINY = np.multiply(TURN, 1e-30)
BEHIND = "a point behind, or within 1e-6 extents before the camera, leaves no trace"
OUTSIDE = "a point outside the volume leaves no trace, and has zero gradient"


def _find_coordinates(points, rotation, focal, distance, *, projection):
    """Continuous indices of the points in the grid; zeros for points outside it."""
    camera = cameras.Camera(focal, distance, projection)
    moved = cameras.to_camera_frame(points, rotation, translation=None, camera=camera)
    return cameras.to_grid(moved, camera=camera, grid=GRID).coordinates


EYE = np.array([[0, 0, 0.3], [0.01, 0.02, 0.2], [0, 0, 0]])
STILL = (1, 0, 0, 0)
BEFORE = EYE + [0, 0, 1e-7]
CROSSING = PLAIN * [1, 1, 0] + [[0, 0, -2], [0, 0, 0], [0, 0, 0.1]]
CLOSE = [[1e-6, -1e-6, 1e-5], [0, 0, 0.3], [0.1, 0, 0.2]]
AT_EYE, AWAY = {"limit": BEHIND}, {"limit": OUTSIDE}
# name, points, rotation, focal length, distance
SCENES = (
    ("plain", PLAIN, TURN, 1.875, 2.0),
    ("one point in the camera plane", CROSSING, STILL, 1.875, 2.0, AT_EYE),
    ("distance 0", EYE, STILL, 0.5, 0.0, AT_EYE),
    ("one point behind the camera", EYE - [0, 0, 0.1], STILL, 0.5, 0.0, AT_EYE),
    ("one point 1e-7 before the plane", BEFORE, STILL, 0.5, 0.0, AT_EYE | IN_WIDE),
    ("focal length 1e-3", PLAIN, TURN, 1e-3, 2.0, IN_WIDE),
    ("focal length 1e3, on the axis", PLAIN * [1e-4, 1e-4, 1], STILL, 1e3, 2.0),
    ("focal length 1e3 from 1e3", PLAIN, TURN, 1e3, 1024.0),
    ("points 1e6 away", PLAIN + 1e6, TURN, 1.875, 2.0, AWAY),
    ("points 1e30 away", PLAIN * 1e30, TURN, 1.875, 2.0, AWAY),
    ("points 3e38 away", np.sign(PLAIN) * 3e38, TURN, 1.875, 2.0, AWAY),
    ("object larger than the volume", PLAIN * 4, TURN, 1.875, 2.0, AWAY),
    ("quaternion of length 1e-30", PLAIN, TINY, 1.875, 2.0, IN_WIDE),
)
# Perspective multiplies roundings by the inverse distance to the eye, orthographic
# projection does not.
AT_CLOSE = ("1e-5 before the eye", CLOSE, STILL, 1.0, 0.0)


def list_cases() -> list[Case]:
    """The catalogue's cases on the camera."""
    cases = []
    for projection, close in (("perspective", 64e3), ("orthographic", 64)):
        cases += make_cases(
            projection,
            functools.partial(_find_coordinates, projection=projection),
            functools.partial(_place, is_flat=projection == "orthographic"),
            (32, 64),
            [*SCENES, (*AT_CLOSE, IN_WIDE | {"gradient_tolerance": close})],
            because="30 roundings of numbers of a few cells; a point close to the eye "
            "multiplies them",
            floor=1.0,
            half="finite",
        )
    return cases


def _place(*inputs, is_flat):
    return oracles.place(*inputs, shape=SHAPE, orthographic=is_flat)[0]
