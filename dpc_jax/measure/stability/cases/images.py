"""Whole images: colour and depth where rays are nearly empty, and `project` itself."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import DTYPES, WIDE, Case
from dpc_jax.render import Camera, VoxelGrid, project

SUBJECT = "colour and depth"
SHAPE = (4, 3, 5)
GRID = VoxelGrid(SHAPE)
ALL = ("silhouette", "depth", "color")
TURN = (0.8, 0.1, -0.3, 0.2)
POINTS = np.array(
    [[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.01, -0.35], [-0.1, -0.2, 0.13]]
)
COLORS = np.array([[0.1, 0.9], [0.5, 0.2], [0.0, 1.0], [0.7, 0.7]])
AFAR = np.array([[9, 9, 9.0]] * 4)
BACKGROUND = "a ray without density shows the background"
FULL = "above density 1 a cell is full: the slope of its mass is zero"


def render(points, rotation, sigma, scale, colors, *, method):
    """The three images of a cloud."""
    image = project(
        points,
        rotation,
        sigma=sigma,
        scale=scale,
        colors=colors,
        camera=Camera(1.875, 2.0),
        grid=GRID,
        signals=ALL,
        method=method,
    )
    return image.silhouette, image.depth, image.color


def render_covariances(points, rotation, sides, scale, colors):
    """The same with covariances (I·s)², which turn and zoom with the object."""
    matrices = sides[:, None, None] ** 2 * jnp.array(np.eye(3) + TILT, points.dtype)
    image = project(
        points,
        rotation,
        covariance=matrices,
        scale=scale,
        colors=colors,
        camera=Camera(1.875, 2.0),
        grid=GRID,
        signals=ALL,
    )
    return image.silhouette, image.depth, image.color


TILT = np.array([[0.5, 0.25, 0], [0.25, 0, -0.125], [0, -0.125, 0.25]])


def make_matrices(points, rotation, sides):
    """The covariances of `render_covariances` in the grid."""
    matrices = (sides * sides)[:, None, None] * (np.eye(3) + TILT)
    return image_oracles.move_covariances(
        points, rotation, matrices, shape=SHAPE, focal=1.875, distance=2.0
    )


SHARED = {m: functools.partial(render, method=m) for m in ("trilinear", "gaussian")}


def list_cases() -> list[Case]:
    """The catalogue's cases on whole images."""
    one = np.array([1e-12, 0, 0, 0])
    plain = {"points": POINTS, "rotation": TURN, "sigma": 0.6, "scale": [0.6] * 4}
    plain["colors"] = COLORS
    scenes = {
        "plain": ({}, ""),
        "no point near any ray": ({"points": AFAR}, BACKGROUND),
        "one point of mass 1e-12": ({"scale": one}, ""),
        "one point of mass 1e-30": ({"scale": one * 1e-18}, ""),
        "mass 0": ({"scale": [0] * 4}, BACKGROUND),
        "mass 1e6": ({"scale": [1e6] * 4}, FULL),
        "masses from 1e-12 to 1e6": ({"scale": [1e-12, 1e-6, 1, 1e6]}, FULL),
        "colours 1e6": ({"colors": COLORS * 1e6}, ""),
        "colours 1e30": ({"colors": COLORS * 1e30}, ""),
        "colours 1e-30": ({"colors": COLORS * 1e-30}, ""),
        "colours below 0": ({"colors": -COLORS}, ""),
        "sigma 0": ({"sigma": 0.0}, "below 0.02 voxels sigma has zero gradient"),
        "sigma 1e-30": ({"sigma": 1e-30}, "below 0.02 voxels sigma has zero gradient"),
        "sigma 0.05": ({"sigma": 0.05}, ""),
        "sigma 1e3": ({"sigma": 1e3}, ""),
        "quaternion of length 1e-30": ({"rotation": np.multiply(TURN, 1e-30)}, ""),
        "quaternion of length 1e30": ({"rotation": np.multiply(TURN, 1e30)}, ""),
        "half turn": ({"rotation": (0, 1, 0, 0)}, ""),
        "an object 1e6 wide": ({"points": POINTS * 1e6}, BACKGROUND),
        "an object 1e-6 wide": ({"points": POINTS * 1e-6 + [0.1, 0.07, 0.03]}, ""),
    }
    cases = []
    for method, function in SHARED.items():
        for name, (changes, limit) in scenes.items():
            is_exact = method == "gaussian"
            inputs = plain | changes
            if is_exact:  # a size per point, which is what the method is for
                inputs["sigma"] = np.multiply(inputs["sigma"], [1, 1.5, 0.7, 1.1])
            oracle = functools.partial(
                image_oracles.render, shape=SHAPE, is_exact=is_exact
            )
            cases.append(
                _make_case(f"{method}: {name}", function, inputs, oracle, limit)
            )
    for name, sides in {
        "plain": [0.6, 0.8, 1.0, 1.2],
        "sizes over 1e6": [1e-3, 0.3, 30, 1e3],
    }.items():
        inputs = plain | {"sigma": sides}
        oracle = functools.partial(
            image_oracles.render, shape=SHAPE, covariance_of=make_matrices
        )
        cases.append(
            _make_case(f"covariance: {name}", render_covariances, inputs, oracle)
        )
    return cases


ROUNDINGS = "coordinates of a few cells carry 30 roundings, kernels multiply them by "
ROUNDINGS += "their slope, rays by their length"
# What else a scene multiplies roundings by: factor of the gradient's, and why.
TAILS = "; of mass 1e6 the tails count, at exponents of 14"
STEEP = {
    "mass 1e6": (4, TAILS),
    "masses from 1e-12 to 1e6": (4, TAILS),
    "sigma 0.05": (400, "; so narrow a kernel has slopes of 1/2σ² = 400 a voxel"),
}


def _make_case(name, function, inputs, oracle, limit=""):
    is_extreme = "e-" in name or "e3" in name or "e6" in name
    factor, reason = STEEP.get(name.partition(": ")[2], (1, ""))
    floors = (1e-30,) * 5
    if name == "trilinear: sigma 1e3":
        # To a place: the difference of two cells' readings, 3e-8 of points and pose.
        floors = (3e-8, 3e-8, *floors[2:])
    return Case(
        name=name,
        subject=SUBJECT,
        function=function,
        inputs=tuple(inputs.values()),
        oracle=oracle,
        value_tolerance=128,
        gradient_tolerance=1024 * factor,
        because=ROUNDINGS + reason,
        half="finite",
        gradient_floor=floors,
        limit=limit,
        dtypes=WIDE if is_extreme else DTYPES,
    )
