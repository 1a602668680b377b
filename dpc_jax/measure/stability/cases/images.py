"""Whole images: colour and depth where rays are nearly empty, and `project` itself."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import IN_WIDE, Case, make_cases
from dpc_jax.render import Camera, VoxelGrid, project

SUBJECT = "colour and depth"
SHAPE = (4, 3, 5)
TURN = (0.8, 0.1, -0.3, 0.2)
POINTS = np.array(
    [[0.1, -0.2, 0.3], [-0.3, 0.25, -0.1], [0.05, 0.01, -0.35], [-0.1, -0.2, 0.13]]
)
COLORS = np.array([[0.1, 0.9], [0.5, 0.2], [0.0, 1.0], [0.7, 0.7]])
PLAIN = {"points": POINTS, "rotation": TURN, "sigma": 0.6, "scale": [0.6] * 4}
PLAIN["colors"] = COLORS
ONE = np.array([1e-12, 0, 0, 0])
MANY = (1e-12, 1e-6, 1, 1e6)
TILT = np.array([[0.5, 0.25, 0], [0.25, 0, -0.125], [0, -0.125, 0.25]])

BACKGROUND = {"limit": "a ray without density shows the background"}
FULL = {"limit": "above density 1 a cell is full: the slope of its mass is zero"}
FLOOR = {"limit": "below 0.02 voxels sigma has zero gradient"}
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
# What differs from `PLAIN`, and the fields of `Case`.
SCENES = (
    ("plain", {}, {}),
    ("no point near any ray", {"points": np.full((4, 3), 9.0)}, BACKGROUND),
    ("one point of mass 1e-12", {"scale": ONE}, IN_WIDE),
    ("one point of mass 1e-30", {"scale": ONE * 1e-18}, IN_WIDE),
    ("mass 0", {"scale": [0] * 4}, BACKGROUND),
    ("mass 1e6", {"scale": [1e6] * 4}, IN_WIDE | FULL | TAILS),
    ("masses from 1e-12 to 1e6", {"scale": MANY}, IN_WIDE | FULL | TAILS),
    ("colours 1e6", {"colors": COLORS * 1e6}, IN_WIDE),
    ("colours 1e30", {"colors": COLORS * 1e30}, IN_WIDE),
    ("colours 1e-30", {"colors": COLORS * 1e-30}, IN_WIDE),
    ("colours below 0", {"colors": -COLORS}, {}),
    ("sigma 0", {"sigma": 0.0}, FLOOR),
    ("sigma 1e-30", {"sigma": 1e-30}, IN_WIDE | FLOOR),
    ("sigma 0.05", {"sigma": 0.05}, NARROW),
    ("sigma 1e3", {"sigma": 1e3}, IN_WIDE),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("quaternion of length 1e30", {"rotation": np.multiply(TURN, 1e30)}, IN_WIDE),
    ("half turn", {"rotation": (0, 1, 0, 0)}, {}),
    ("an object 1e6 wide", {"points": POINTS * 1e6}, IN_WIDE | BACKGROUND),
    ("an object 1e-6 wide", {"points": POINTS * 1e-6 + [0.1, 0.07, 0.03]}, IN_WIDE),
)
COVARIANCES = (
    ("plain", {"sigma": [0.6, 0.8, 1.0, 1.2]}, {}),
    ("sizes over 1e6", {"sigma": [1e-3, 0.3, 30, 1e3]}, IN_WIDE),
)
# The gradient to a place is a difference of two cells' readings, which the wide kernel
# makes 3e-8 of what they are; so it is for the pose.
TO_PLACES = {"gradient_floor": (3e-8, 3e-8, 1e-30, 1e-30, 1e-30)}


def _render(points, rotation, sizes, scale, colors, *, method):
    """The three images of a cloud.

    With the method "covariance", sizes are the s of covariances s²·(I + `TILT`), which
    turn and zoom with the object; else they are sigma.
    """
    tilted = jnp.array(np.eye(3) + TILT, points.dtype)
    is_tilted = method == "covariance"
    image = project(
        points,
        rotation,
        sigma=None if is_tilted else sizes,
        covariance=sizes[:, None, None] ** 2 * tilted[None] if is_tilted else None,
        scale=scale,
        colors=colors,
        camera=Camera(1.875, 2.0),
        grid=VoxelGrid(SHAPE),
        signals=("silhouette", "depth", "color"),
        method="auto" if is_tilted else method,
    )
    return image.silhouette, image.depth, image.color


def _make_matrices(points, rotation, sides):
    """The covariances of `_render` in the grid."""
    matrices = (sides * sides)[:, None, None] * (np.eye(3) + TILT)
    return image_oracles.move_covariances(points, rotation, matrices, shape=SHAPE)


def list_cases() -> list[Case]:
    """The catalogue's cases on whole images."""
    cases = []
    for method, scenes, kind in (
        ("trilinear", SCENES, {}),
        ("gaussian", SCENES, {"is_exact": True}),
        ("covariance", COVARIANCES, {"covariance_of": _make_matrices}),
    ):
        rows = []
        for name, inputs, fields in scenes:
            inputs = PLAIN | inputs
            if method == "gaussian":  # a size per point, which is what it is for
                inputs["sigma"] = np.multiply(inputs["sigma"], [1, 1.5, 0.7, 1.1])
            if (method, name) == ("trilinear", "sigma 1e3"):
                fields = fields | TO_PLACES
            rows.append((name, *inputs.values(), fields))
        cases += make_cases(
            method,
            functools.partial(_render, method=method),
            functools.partial(image_oracles.render, shape=SHAPE, **kind),
            (128, 1024),
            rows,
            because=ROUNDINGS,
            half="finite",
            gradient_floor=(1e-30,) * 5,
        )
    return cases
