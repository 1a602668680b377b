"""Ordinary scenes, and sums of more and more terms: what float32's rounding costs.

The reference is the function itself in float64. Independent rounding errors of n terms
add up as √n, and so do the tolerances.
"""

import functools
import math

import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.scenes import draw_ball, make_scenes
from dpc_jax.measure.stability.case import Case, make_cases
from dpc_jax.measure.stability.image_cases import render_cloud
from dpc_jax.measure.stability.runner import tabulate
from dpc_jax.render import (
    VoxelGrid,
    opacity,
    project,
    smooth,
    termination_probabilities,
)

COUNT, SIDE = 200, 32  # points and cells of an ordinary scene
SINGLE = {"dtypes": ("float32",)}


def _list_scenes() -> list[Case]:
    """Cases of `project` on a car, a chair, a block and a sparse cloud."""
    rng = np.random.default_rng(COUNT)
    axes = rng.normal(0, 0.8, (COUNT, 3, 3))
    matrices = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(3)
    colors = rng.uniform(0, 1, (COUNT, 3))
    scenes = make_scenes(num_points=COUNT, num_sparse=COUNT, seed=0)
    cases = []
    for method, title, sizes in (
        ("trilinear", "trilinear, one sigma", 1.3),
        ("cubic", "cubic, one sigma", 1.3),
        ("gaussian", "gaussian, one sigma", 1.3),
        ("levels", "levels, sigma per point", rng.uniform(0.7, 2.5, COUNT)),
        ("auto", "sigma per point", rng.uniform(0.7, 2.5, COUNT)),
        ("auto", "covariances", matrices),
    ):
        rows = [
            (
                *(s.name, s.points, s.pose, sizes, s.mass / 8, colors),
                *((0.02, -0.03, 0.01), 1.875, 2.0),
                {"is_slow": s is not scenes[0] or method != "trilinear"},
            )
            for s in scenes
        ]
        cases += make_cases(
            title,
            functools.partial(render_cloud, method=method, shape=(SIDE,) * 3),
            *(None, (16, 1024), rows),
            because="4 and 8 times the worst error measured: gradients are sums of "
            "terms of both signs, most of which cancel",
            **SINGLE,
        )
    return cases


def _fill(points, rotation, scale, *, method):
    share = scale / len(points)
    look = {"sigma": 1.0, "grid": VoxelGrid(16), "method": method}
    return project(points, rotation, scale=share, **look).silhouette


_TRILINEAR, _GAUSSIAN = (
    functools.partial(_fill, method=method) for method in ("trilinear", "gaussian")
)
# What adds up how many terms n of which kind, and the tolerance of the gradient in
# units of √n epsilons; that of the value is four.
SUMS = (
    # Trilinear weights have a kink at a cell's centre: of 10⁵ points one lies within
    # rounding of it, and float32 takes the other side's slope.
    ("trilinear", _TRILINEAR, "points", 1000, 64),
    ("trilinear", _TRILINEAR, "points", 100_000, 64),
    ("gaussian", _GAUSSIAN, "points", 1000, 64),
    ("gaussian", _GAUSSIAN, "points", 100_000, 64),
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
    if kind == "points":
        # A fixed mass fills an ellipsoid to a half. It is turned, so that no symmetry
        # makes the rotation's gradient vanish.
        return points, (0.8, 0.4, 0, 0.4), 160
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
            because="√n roundings, of which half an epsilon is left on the average; "
            "four times the largest of four clouds",
            is_slow=n > 64,
            **SINGLE,
        )
    return cases


ROWS = tabulate(scene=_list_scenes(), sum=_list_sums())
