"""Ordinary scenes, and sums of more and more terms: what float32's rounding costs.

The reference is the function itself in float64. Independent rounding errors of n terms
add up as √n, and so do the tolerances.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability.case import Case, make_cases
from dpc_jax.measure.stability.image_cases import render_cloud
from dpc_jax.render import VoxelGrid, opacity, project, smooth
from dpc_jax.render import termination_probabilities as terminate

COUNT, SIDE = 200, 32  # points and cells of an ordinary scene
SIZES = ("one sigma", "sigma per point", "covariances")
CROWDS, SIDES = (100, 1000, 10_000, 100_000), (16, 48, 128)
LENGTHS = (16, 64, 256, 1024, 4096)
SINGLE = {"dtypes": ("float32",)}
# Of the sums: the worst of four clouds, times four.
BECAUSE = "√n roundings, of which half an epsilon is left on the average; four times "
BECAUSE += "the largest measured"
KINK = (
    "trilinear weights have a kink at a cell's centre: of 10⁵ points one lies within "
)
KINK += "rounding of it, and float32 takes the other side's slope"


def list_scenes() -> list[Case]:
    """Cases of `project` on a car, a chair, a block and a sparse cloud."""
    cases = []
    for size in SIZES:
        for method in ("trilinear", "gaussian") if size == "one sigma" else ("auto",):
            rows = [
                (
                    scene.name,
                    *_draw_inputs(scene, size),
                    {"is_slow": i > 0 or method != "trilinear"},
                )
                for i, scene in enumerate(
                    make_scenes(num_points=COUNT, num_sparse=COUNT, seed=0)
                )
            ]
            cases += make_cases(
                f"{method}, {size}".removeprefix("auto, "),
                functools.partial(render_cloud, method=method, shape=(SIDE,) * 3),
                *(None, (16, 1024), rows),
                because="4 and 8 times the worst error measured: gradients are sums "
                "of terms of both signs, most of which cancel",
                **SINGLE,
            )
    return cases


def _draw_inputs(scene, size):
    rng = np.random.default_rng(COUNT)
    axes = rng.normal(0, 0.8, (COUNT, 3, 3))
    sizes = {
        "one sigma": 1.3,
        "sigma per point": rng.uniform(0.7, 2.5, COUNT),
        "covariances": axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(3),
    }
    return (
        *(scene.points, scene.pose, sizes[size], scene.mass / 8),
        *(rng.uniform(0, 1, (COUNT, 3)), (0.02, -0.03, 0.01), 1.875, 2.0),
    )


def list_sums() -> list[Case]:
    """Cases of sums over points, cells, pixels and rays."""
    cases = []
    for method in ("trilinear", "gaussian"):
        fill = functools.partial(_fill, method=method)
        fields = {"limit": KINK} if method == "trilinear" else {}
        for count in CROWDS:
            cases += _sum(f"{method}, points", fill, count, (4, 64), fields)
    for count in CROWDS:
        cases += _sum("loss, pixels", reprojection_loss, count, (4, 4))
    for side in SIDES:
        # A cell is a sum along each axis, sigma's gradient one over all cells: √n³.
        cases += _sum("smooth, cells", _smooth, side, (4, side / 4))
    for length in LENGTHS:
        cases += _sum("opacity, cells of a ray", opacity, length, (4, 4))
        cases += _sum("termination, cells of a ray", terminate, length, (4, 4))
    return cases


def _sum(title, function, n, tolerances, fields=None):
    """The case of a sum of n terms; tolerances are in units of √n epsilons."""
    rng = np.random.default_rng(n)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * rng.uniform(0, 1, (n, 1)) ** (1 / 3) * (0.42, 0.28, 0.16)
    inputs = {
        # A fixed mass fills an ellipsoid to a half. It is turned, so that no symmetry
        # makes the rotation's gradient vanish.
        "points": lambda: (points, (0.8, 0.4, 0, 0.4), 160),
        "pixels": lambda: rng.uniform(0, 1, (2, n)),
        "cells": lambda: (rng.uniform(0, 1, (n, n, n)), n / 8),
        # A mean occupancy of 2/n: the ray's sum stays at two.
        "cells of a ray": lambda: (rng.uniform(0, 4 / n, (16, n)),),
    }[title.partition(", ")[2]]()
    factors = (tolerance * math.sqrt(n) for tolerance in tolerances)
    return make_cases(
        title,
        *(function, None, tuple(factors), [(str(n), *inputs, fields or {})]),
        because=BECAUSE,
        terms=n,
        is_slow=n > 64,
        **SINGLE,
    )


def _fill(points, rotation, scale, *, method):
    share = scale / len(points)
    look = {"sigma": 1.0, "grid": VoxelGrid(16), "method": method}
    return project(points, rotation, scale=share, **look).silhouette


def _smooth(volume, sigma):
    return smooth(volume, jnp.asarray(sigma, volume.dtype))


CASES = {"scene": list_scenes, "sum": list_sums}
