"""Ordinary scenes, and sums of more and more terms: what float32's rounding costs.

The reference is the function itself in float64. Independent rounding errors of n terms
add up as √n, and so do the tolerances.
"""

import functools
import math

import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.stability.case import Case, make_cases
from dpc_jax.measure.stability.image_cases import render_cloud
from dpc_jax.render import VoxelGrid, opacity, project, smooth
from dpc_jax.render import termination_probabilities as terminate

COUNT, SIDE = 200, 32  # points and cells of an ordinary scene
SINGLE = {"dtypes": ("float32",)}
KINK = (
    "trilinear weights have a kink at a cell's centre: of 10⁵ points one lies within "
    "rounding of it, and float32 takes the other side's slope"
)


def list_scenes() -> list[Case]:
    """Cases of `project` on a car, a chair, a block and a sparse cloud."""
    rng = np.random.default_rng(COUNT)
    axes = rng.normal(0, 0.8, (COUNT, 3, 3))
    matrices = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(3)
    colors = rng.uniform(0, 1, (COUNT, 3))
    cases = []
    for method, title, sizes in (
        ("trilinear", "one sigma", 1.3),
        ("cubic", "one sigma", 1.3),
        ("gaussian", "one sigma", 1.3),
        ("levels", "sigma per point", rng.uniform(0.7, 2.5, COUNT)),
        ("auto", "sigma per point", rng.uniform(0.7, 2.5, COUNT)),
        ("auto", "covariances", matrices),
    ):
        scenes = make_scenes(num_points=COUNT, num_sparse=COUNT, seed=0)
        rows = [
            (
                *(s.name, s.points, s.pose, sizes, s.mass / 8, colors),
                *((0.02, -0.03, 0.01), 1.875, 2.0),
                {"is_slow": s is not scenes[0] or method != "trilinear"},
            )
            for s in scenes
        ]
        cases += make_cases(
            f"{method}, {title}".removeprefix("auto, "),
            functools.partial(render_cloud, method=method, shape=(SIDE,) * 3),
            *(None, (16, 1024), rows),
            because="4 and 8 times the worst error measured: gradients are sums of "
            "terms of both signs, most of which cancel",
            **SINGLE,
        )
    return cases


def list_sums() -> list[Case]:
    """Cases of sums over points, cells, pixels and rays."""
    cases = []
    for method, fields in (("trilinear", {"limit": KINK}), ("gaussian", {})):
        fill = functools.partial(_fill, method=method)
        for count in (1000, 100_000):
            cases += _sum(f"{method}, points", fill, count, (4, 64), fields)
    cases += _sum("loss, pixels", reprojection_loss, 100_000, (4, 4), {})
    for side in (16, 128):
        # A cell is a sum along each axis, sigma's gradient one over all cells: √n³.
        cases += _sum("smooth, cells", smooth, side, (4, side / 4), {})
    for length in (64, 4096):
        cases += _sum("opacity, cells of a ray", opacity, length, (4, 4), {})
        cases += _sum("termination, cells of a ray", terminate, length, (4, 4), {})
    return cases


def _sum(title, function, n, tolerances, fields):
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
    factors = tuple(tolerance * math.sqrt(n) for tolerance in tolerances)
    return make_cases(
        title,
        *(function, None, factors, [(str(n), *inputs, fields)]),
        because="√n roundings, of which half an epsilon is left on the average; four "
        "times the largest of four clouds",
        is_slow=n > 64,
        **SINGLE,
    )


def _fill(points, rotation, scale, *, method):
    share = scale / len(points)
    look = {"sigma": 1.0, "grid": VoxelGrid(16), "method": method}
    return project(points, rotation, scale=share, **look).silhouette


CASES = {"scene": list_scenes, "sum": list_sums}
