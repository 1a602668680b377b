"""Cameras: points at, behind and just before the eye, far away, extreme lenses."""

import functools

import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import WIDE, Case
from dpc_jax.render import camera as cameras

SUBJECT = "camera"
SHAPE = (8, 6, 4)
GRID = cameras.VoxelGrid(SHAPE)
PLAIN = np.array([[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.0, -0.35]])
TURN = (0.8, 0.1, -0.3, 0.2)
BEHIND = "a point behind, or within 1e-6 extents before the camera, leaves no trace"
OUTSIDE = "a point outside the volume leaves no trace, and has zero gradient"


def find_coordinates(points, rotation, focal, distance, *, projection):
    """Indices of the points in the grid; zeros for those outside."""
    camera = cameras.Camera(focal, distance, projection)
    moved = cameras.to_camera_frame(points, rotation, translation=None, camera=camera)
    return cameras.to_grid(moved, camera=camera, grid=GRID).coordinates


def list_cases() -> list[Case]:
    """The catalogue's cases on the camera."""
    eye = np.array([[0, 0, 0.3], [0.01, 0.02, 0.2], [0, 0, 0]])
    still = (1, 0, 0, 0)
    scenes = {
        "plain": (PLAIN, TURN, 1.875, 2.0, ""),
        "one point in the camera plane": (
            PLAIN * [1, 1, 0] + [[0, 0, -2], [0, 0, 0], [0, 0, 0.1]],
            still,
            1.875,
            2.0,
            BEHIND,
        ),
        "one point 1e-7 before the plane": (
            eye + [0, 0, 1e-7],
            still,
            0.5,
            0.0,
            BEHIND,
        ),
        "one point behind the camera": (eye - [0, 0, 0.1], still, 0.5, 0.0, BEHIND),
        "distance 0": (eye, still, 0.5, 0.0, BEHIND),
        "1e-5 before the eye": (
            [[1e-6, -1e-6, 1e-5], [0, 0, 0.3], [0.1, 0, 0.2]],
            still,
            1.0,
            0.0,
            "",
        ),
        "focal length 1e-3": (PLAIN, TURN, 1e-3, 2.0, ""),
        "focal length 1e3, on the axis": (PLAIN * [1e-4, 1e-4, 1], still, 1e3, 2.0, ""),
        "focal length 1e3 from 1e3": (
            PLAIN,
            TURN,
            1e3,
            1024.0,
            "",
        ),
        "points 1e6 away": (PLAIN + 1e6, TURN, 1.875, 2.0, OUTSIDE),
        "points 1e30 away": (PLAIN * 1e30, TURN, 1.875, 2.0, OUTSIDE),
        "points 3e38 away": (np.sign(PLAIN) * 3e38, TURN, 1.875, 2.0, OUTSIDE),
        "object larger than the volume": (PLAIN * 4, TURN, 1.875, 2.0, OUTSIDE),
        "quaternion of length 1e-30": (PLAIN, np.multiply(TURN, 1e-30), 1.875, 2.0, ""),
    }
    cases = []
    for projection in cameras.PROJECTIONS:
        is_flat = projection == "orthographic"
        function = functools.partial(find_coordinates, projection=projection)
        for name, (points, rotation, focal, distance, limit) in scenes.items():
            close = 1e3 if name.startswith("1e-5") and not is_flat else 1.0
            cases.append(
                Case(
                    name=f"{projection}: {name}",
                    subject=SUBJECT,
                    function=function,
                    inputs=(points, rotation, focal, distance),
                    oracle=functools.partial(_place, is_flat=is_flat),
                    value_tolerance=32,
                    gradient_tolerance=64 * close,
                    because="30 roundings of numbers of a few cells; a point close "
                    "to the eye multiplies them",
                    floor=1.0,
                    half="finite",
                    limit=limit or "",
                    dtypes=WIDE if "1e-" in name else Case.dtypes,
                )
            )
    return cases


def _place(points, rotation, focal, distance, *, is_flat):
    return oracles.place(
        points,
        rotation,
        focal=focal,
        distance=distance,
        shape=SHAPE,
        orthographic=is_flat,
    )[0]
